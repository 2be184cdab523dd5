"""Write the data of code:Sample, plugins/gem-code/gem_code/data/sample.jsonl, from the problems in the plugin's tests.

Run it after a change there: ``python scripts/code_sample.py``. A test compares the two.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

PLUGIN = Path(__file__).resolve().parent.parent / "plugins" / "gem-code"


def main() -> None:
    """Write the file."""
    sys.path.insert(0, str(PLUGIN / "tests"))
    build = importlib.import_module("problems.build")
    target = PLUGIN / "gem_code" / "data" / "sample.jsonl"
    target.write_text(build.as_text(), encoding="utf-8")
    print(f"{len(build.PROBLEMS)} problems, {target.stat().st_size:,} bytes in {target}")


if __name__ == "__main__":
    main()
