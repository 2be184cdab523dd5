"""Make the tasks of terminal:Sample in both formats, from the folders beside this file.

A folder holds ``task.toml`` (what the task says of itself), ``instruction.md``, ``environment/`` (the Dockerfile and
what it copies), ``checks.py``, ``solution.sh`` and, in ``wrong/``, solutions that must fail: each says in a
line that begins with ``# fails:`` by which checks. ``shared/`` has what runs the checks of all.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
SHARED = HERE / "shared"
AGENT_SECONDS = 600
VERIFIER_SECONDS = 120

COMPOSE = """\
services:
  client:
    build:
      dockerfile: Dockerfile
    image: ${T_BENCH_TASK_DOCKER_CLIENT_IMAGE_NAME}
    container_name: ${T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME}
    command: ["sh", "-c", "sleep infinity"]
    environment:
      - TEST_DIR=${T_BENCH_TEST_DIR}
    volumes:
      - ${T_BENCH_TASK_LOGS_PATH}:${T_BENCH_CONTAINER_LOGS_PATH}
      - ${T_BENCH_TASK_AGENT_LOGS_PATH}:${T_BENCH_CONTAINER_AGENT_LOGS_PATH}
"""
# -I -S: neither variables nor packages that the agent may have left have a part in it.
RUN_TESTS = """\
#!/bin/bash
# Runs the checks; what it prints ends as pytest's output does with -rA.
exec python3 -ISB "${TEST_DIR:-/tests}/runner.py"
"""
TEST = """\
#!/bin/bash
# Runs the checks, and writes the reward and a report of each check.
exec python3 -ISB /tests/runner.py /logs/verifier
"""


@dataclass(frozen=True)
class Source:
    """A task as it is written.

    Args:
        name: Its name.
        folder: Where it is.
        instruction: What the agent is asked to do.
        about: What it says of itself: ``description``, ``difficulty``, ``category``, ``tags``.
    """

    name: str
    folder: Path
    instruction: str
    about: dict[str, str | list[str]]

    def wrong(self) -> dict[str, Path]:
        """Return the solutions that must fail, by name."""
        return {path.stem: path for path in sorted(self.folder.glob("wrong/*.sh"))}

    def environment(self) -> dict[str, bytes]:
        """Return the files that the image is built from."""
        return below(self.folder / "environment")

    def tests(self) -> dict[str, bytes]:
        """Return the files of the verifier but its entry point."""
        return {"checks.py": (self.folder / "checks.py").read_bytes(), **below(SHARED)}


def sources() -> list[Source]:
    """Return all tasks, by name."""
    return [
        Source(
            path.parent.name,
            path.parent,
            (path.parent / "instruction.md").read_text(encoding="utf-8").strip(),
            tomllib.loads(path.read_text(encoding="utf-8")),
        )
        for path in sorted(HERE.glob("*/task.toml"))
    ]


def caught_by(wrong: Path) -> set[str]:
    """Return the names of the checks that a wrong solution fails by, as it says itself."""
    lines = wrong.read_text(encoding="utf-8").splitlines()
    return {name for line in lines if line.startswith("# fails: ") for name in line.split()[2:]}


def below(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files below a folder, by relative path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def moved(files: dict[str, bytes], folder: str) -> dict[str, bytes]:
    """Return files with paths below a folder."""
    return {f"{folder}/{name}": content for name, content in files.items()}


def terminal_bench(task: Source) -> dict[str, bytes]:
    """Return the files of a task in the format of Terminal-Bench v1."""
    lines = ["instruction: |-"]
    lines += [f"  {line}".rstrip() for line in task.instruction.splitlines()]
    lines += ["author_name: GEM"]
    lines += [f"{key}: {json.dumps(task.about[key])}" for key in ("difficulty", "category", "tags")]
    lines += ["parser_name: pytest", f"max_agent_timeout_sec: {AGENT_SECONDS}"]
    lines += [f"max_test_timeout_sec: {VERIFIER_SECONDS}", "run_tests_in_same_shell: false", ""]
    return {
        "task.yaml": "\n".join(lines).encode(),
        **task.environment(),
        "docker-compose.yaml": COMPOSE.encode(),
        "run-tests.sh": RUN_TESTS.encode(),
        **moved(task.tests(), "tests"),
        "solution.sh": (task.folder / "solution.sh").read_bytes(),
    }


def harbor(task: Source) -> dict[str, bytes]:
    """Return the files of a task in the format of Harbor."""
    description = json.dumps(task.about["description"])
    lines = ['schema_version = "1.4"', "", "[task]", f'name = "gem/{task.name}"', f"description = {description}"]
    lines += ["", "[metadata]"]
    lines += [f"{key} = {json.dumps(task.about[key])}" for key in ("difficulty", "category", "tags")]
    lines += [
        "",
        "[agent]",
        f"timeout_sec = {AGENT_SECONDS}.0",
        "",
        "[verifier]",
        f"timeout_sec = {VERIFIER_SECONDS}.0",
    ]
    lines += ["", "[environment]", "cpus = 1", "memory_mb = 512", 'network_mode = "no-network"', ""]
    return {
        "task.toml": "\n".join(lines).encode(),
        "instruction.md": f"{task.instruction}\n".encode(),
        **moved(task.environment(), "environment"),
        "tests/test.sh": TEST.encode(),
        **moved(task.tests(), "tests"),
        "solution/solve.sh": (task.folder / "solution.sh").read_bytes(),
    }


FORMATS = {"terminal-bench": terminal_bench, "harbor": harbor}


def all_files() -> dict[str, bytes]:
    """Return the files of all tasks in both formats, by their paths in the folder of the data."""
    return {
        f"{name}/{task.name}/{path}": content
        for name, make in FORMATS.items()
        for task in sources()
        for path, content in make(task).items()
    }
