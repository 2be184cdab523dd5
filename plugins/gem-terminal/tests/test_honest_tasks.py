"""Honest work of fifteen kinds is rewarded by default, on a real engine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from docker_machines import BASE, needs_engine
from honest_tasks import HONEST, write_honest

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.interface import Limits
from gem_terminal.selecting import select_tasks
from gem_terminal.shell import Shell
from gem_terminal.verifying.verify import verify

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

pytestmark = needs_engine
LIMITS = Limits(memory_mb=256, processes=64, storage_mb=256)


@pytest.fixture(scope="module")
def backend() -> Iterator[DockerBackend]:
    """Give a real backend."""
    backend = DockerBackend(build_args={"BASE": BASE})
    yield backend
    backend.close()


@pytest.fixture(scope="module")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Task]:
    """Give the tasks by name."""
    return {task.name: task for task in select_tasks(write_honest(tmp_path_factory.mktemp("honest")))}


@pytest.mark.few(5)
@pytest.mark.parametrize("name", HONEST)
def test_honest_solution_is_rewarded_and_nothing_is_not(
    backend: DockerBackend, tasks: dict[str, Task], name: str
) -> None:
    """In one machine: the tests fail before the agent's shell has done the work, and pass afterwards."""
    task = tasks[name]
    step = task.steps[0]
    with backend.start(task, LIMITS) as machine:
        before = verify(machine, task, step, backend=backend, limits=LIMITS)
        assert (before.passed, before.score, before.problem) == (False, 0.0, None), before
        shell = Shell(machine, workdir="/app")
        shell.open()
        done = shell.run(HONEST[name].solution, 30.0)
        assert done.exit_code == 0, done
        after = verify(machine, task, step, backend=backend, limits=LIMITS)
        shell.close()
        assert (after.passed, after.score, after.problem) == (True, 1.0, None), after


@pytest.mark.thorough
def test_check_finds_honest_tasks_sound(tmp_path: Path) -> None:
    """Each in two machines of its own, the solution run without the agent's shell."""
    write_honest(tmp_path)
    command = [sys.executable, "-m", "gem_core", "terminal", "check", "."]
    variables = {**os.environ, "GEM_TERMINAL_BASE_IMAGE": BASE}
    done = subprocess.run(
        command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
