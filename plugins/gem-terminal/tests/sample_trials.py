"""The sample tasks' names, and the solutions that must fail: ``wrong_solutions/TASK/NAME.sh``.

Each says in a line that begins with ``# fails:`` by which checks it must fail.
"""

from __future__ import annotations

from pathlib import Path

WRONG = {
    folder.name: sorted(folder.glob("*.sh")) for folder in sorted(Path(__file__).with_name("wrong_solutions").iterdir())
}
NAMES = list(WRONG)


def caught_by(wrong: Path) -> set[str]:
    """Return the names of the checks that a wrong solution fails by, as it says itself."""
    lines = wrong.read_text(encoding="utf-8").splitlines()
    return {name for line in lines if line.startswith("# fails: ") for name in line.split()[2:]}
