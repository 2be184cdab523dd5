"""Write the tasks of terminal:Sample, plugins/gem-terminal/gem_terminal/data/sample, from those in the plugin's tests.

Run it after a change there: ``python scripts/terminal_sample.py``. A test compares the two.
"""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path

PLUGIN = Path(__file__).resolve().parent.parent / "plugins" / "gem-terminal"


def main() -> None:
    """Write the folders of both formats anew."""
    sys.path.insert(0, str(PLUGIN / "tests"))
    build = importlib.import_module("sample_tasks.build")
    target = PLUGIN / "gem_terminal" / "data" / "sample"
    shutil.rmtree(target, ignore_errors=True)
    files = build.all_files()
    for name, content in files.items():
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        if path.suffix == ".sh":
            path.chmod(0o755)
    print(f"{len(build.sources())} tasks, {len(files)} files, {sum(map(len, files.values())):,} bytes in {target}")


if __name__ == "__main__":
    main()
