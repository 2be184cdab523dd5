"""``scripts/trainers.py``: what it reads of a file's needs, and what it says of a run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import trainers

ROOT = Path(__file__).parent.parent
TRAINERS = sorted(path.stem for path in (ROOT / "examples" / "trainers").glob("*.py"))


@pytest.mark.thorough
@pytest.mark.parametrize("name", TRAINERS)
def test_trainer_keeps_its_promises(name: str) -> None:
    """Each file runs with its framework, installed from the package index, and ends with exit code 0."""
    python = trainers.needs_of((ROOT / "examples" / "trainers" / f"{name}.py").read_text(encoding="utf-8")).python
    if python is not None and trainers.interpreter_of(python) is None:
        pytest.skip(f"it needs Python {python}")
    command = [sys.executable, "scripts/trainers.py", name]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout[-5000:]


def test_page_has_the_rows_of_the_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As ``--write`` writes them; the version of a trial takes the place of that before it, the rest stays."""
    written = trainers.PAGE.read_text(encoding="utf-8")
    monkeypatch.setattr(trainers, "PAGE", tmp_path / "trainers.md")
    trainers.PAGE.write_text(written, encoding="utf-8")
    trainers.write_page({})
    assert trainers.PAGE.read_text(encoding="utf-8") == written
    trainers.write_page({"rl2_env": "9.9"})
    changed = set(trainers.PAGE.read_text(encoding="utf-8").splitlines()) - set(written.splitlines())
    assert [row.split(" | ")[1:3] for row in changed] == [["`rl2_env.py`", "9.9"]]


def test_every_file_says_what_it_needs() -> None:
    """And what it shows, the version and how it is run, in its docstring."""
    for path in sorted((ROOT / "examples" / "trainers").glob("*.py")):
        source = path.read_text(encoding="utf-8")
        assert source.startswith("# /// script\n"), path.name
        assert trainers.needs_of(source).framework != "gem-train", path.name
        assert f"python examples/trainers/{path.name}" in source, path.name
