"""Task folders for tests: written from a mapping of paths to contents, and read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gem_terminal.tasks.folders import find_tasks

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

TERMINAL_BENCH: Mapping[str, str] = {
    "task.yaml": "instruction: Write 5 to /app/five.txt.\ndifficulty: easy\n",
    "Dockerfile": "FROM gem-python:base\nWORKDIR /app\n",
    "run-tests.sh": "#!/bin/bash\npython3 -m pytest -rA /tests/test_outputs.py\n",
    "tests/test_outputs.py": "def test_five():\n    assert open('/app/five.txt').read() == '5'\n",
}
"""The smallest whole task in the first format of Terminal-Bench, but for its Compose file, which may be missing."""

HARBOR: Mapping[str, str] = {
    "task.toml": 'schema_version = "1.4"\n',
    "instruction.md": "Write 5 to /app/five.txt.\n",
    "environment/Dockerfile": "FROM gem-python:base\nWORKDIR /app\n",
    "tests/test.sh": "#!/bin/bash\necho 1 > /logs/verifier/reward.txt\n",
}
"""The smallest whole task in the format of Harbor."""


def write(folder: Path, *layers: Mapping[str, str | bytes | None]) -> Path:
    """Write files by their paths; those of later layers replace earlier ones, and None leaves one out."""
    files: dict[str, str | bytes | None] = {}
    for layer in layers:
        files |= layer
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if content is None:
            continue
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return folder


def read_task(folder: Path, variables: Mapping[str, str] | None = None) -> Task:
    """Read the one task of a folder."""
    (task,) = find_tasks([folder], variables=variables).tasks
    return task
