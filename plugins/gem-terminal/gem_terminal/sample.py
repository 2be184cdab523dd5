"""The tasks of terminal:Sample, written as task folders of Harbor and of Terminal-Bench when they are first used.

``data/sample/tasks`` has each task once, in Harbor's form, and ``data/sample/shared`` what all of them have alike: the
Dockerfile, the scripts that run the tests, and the modules that the tests import.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

import yaml

from gem_core.errors import ArgumentError
from gem_terminal.errors import TaskError

_DATA = Path(__file__).parent / "data" / "sample"


@functools.cache
def sample_folder(format: str) -> Path:
    """Return a folder with the sample tasks in a format, ``"harbor"`` or ``"terminal-bench"``.

    It is in the user's cache folder under a digest of what it holds.

    Raises:
        ArgumentError: There is no such format.
        TaskError: The cache folder cannot be written to.
    """
    if format not in _WRITERS:
        raise ArgumentError(f"the sample tasks have no format {format!r}; there are: {', '.join(_WRITERS)}")
    shared = _files_below(_DATA / "shared")
    files = {
        f"{task.name}/{name}": content
        for task in sorted((_DATA / "tasks").iterdir())
        for name, content in _WRITERS[format](_files_below(task), shared).items()
    }
    digest = hashlib.sha256(repr(sorted(files.items())).encode()).hexdigest()[:16]
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gem" / "terminal-sample"
    folder = base / f"{format}-{digest}"
    if not folder.is_dir():
        try:
            base.mkdir(parents=True, exist_ok=True)
            _write(files, base, folder)
        except OSError as error:
            raise TaskError(
                f"the sample tasks cannot be written: {error}. Name a cache folder: XDG_CACHE_HOME"
            ) from error
    return folder


def _write(files: Mapping[str, bytes], base: Path, folder: Path) -> None:
    """Write files so that the folder is whole as soon as it is there, however many processes write it at once."""
    with tempfile.TemporaryDirectory(prefix="part-", dir=base) as part:
        root = Path(part, "tasks")
        for name, content in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        for path in (root, *root.rglob("*")):  # whatever the umask: permissions count in a task's digest
            path.chmod(0o755 if path.is_dir() or path.suffix == ".sh" else 0o644)
        try:
            root.rename(folder)
        except OSError:
            if not folder.is_dir():
                raise


def _files_below(folder: Path) -> dict[str, bytes]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _harbor(task: Mapping[str, bytes], shared: Mapping[str, bytes]) -> dict[str, bytes]:
    return {
        **task,
        "environment/Dockerfile": shared["Dockerfile"],
        **{f"tests/{name}": shared[name] for name in ("test.sh", "runner.py", "sample_helpers.py")},
    }


def _terminal_bench(task: Mapping[str, bytes], shared: Mapping[str, bytes]) -> dict[str, bytes]:
    about = tomllib.loads(task["task.toml"].decode())
    compose = yaml.safe_load(shared["docker-compose.yaml"])
    own = yaml.safe_load(task.get("environment/docker-compose.yaml", b"services: {main: {}}"))
    compose["services"]["client"] |= own["services"]["main"]
    instruction = textwrap.indent(task["instruction.md"].decode().strip(), "  ")
    told = {
        "author_name": "GEM",
        **about["metadata"],
        "parser_name": "pytest",
        "max_agent_timeout_sec": about["agent"]["timeout_sec"],
        "max_test_timeout_sec": about["verifier"]["timeout_sec"],
        "run_tests_in_same_shell": False,
    }
    return {
        "task.yaml": f"instruction: |-\n{instruction}\n{yaml.safe_dump(told, sort_keys=False)}".encode(),
        "docker-compose.yaml": yaml.safe_dump(compose, sort_keys=False).encode(),
        "Dockerfile": shared["Dockerfile"],
        **{name.removeprefix("environment/"): task[name] for name in task if name.startswith("environment/setup/")},
        "run-tests.sh": shared["run-tests.sh"],
        **{f"tests/{name}": shared[name] for name in ("runner.py", "sample_helpers.py")},
        **{name: task[name] for name in task if name.startswith("tests/")},
        "solution.sh": task["solution/solve.sh"],
    }


_WRITERS = {"harbor": _harbor, "terminal-bench": _terminal_bench}
