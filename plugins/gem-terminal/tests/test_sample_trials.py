"""The tasks of terminal:Sample, tried: reference solutions pass, wrong ones fail by the checks that should catch them.

Without the mark ``thorough`` each task is tried in one format with each backend; with it, all of them in both. Wrong
solutions, and the other format, take minutes with Docker: they are tried there with ``GEM_EVERY_TERMINAL_TRIAL=1``.
"""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import docker.errors
import pytest
from sample_tasks import build

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.interface import Backend, Limits
from gem_terminal.backends.local.backend import LocalBackend
from gem_terminal.errors import EngineError
from gem_terminal.tasks.folders import read_task
from gem_terminal.verifying.solutions import solve
from gem_terminal.verifying.verify import verify

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verdict import Verdict

DATA = Path(__file__).resolve().parent.parent / "gem_terminal" / "data" / "sample"
BASE = os.environ.get("GEM_TERMINAL_BASE_IMAGE", "gem-python:base")
LIMITS = Limits(memory_mb=512, processes=128, storage_mb=256)
EVERY = bool(os.environ.get("GEM_EVERY_TERMINAL_TRIAL"))
SOURCES = build.sources()
FORMATS = tuple(build.FORMATS)


def docker_backend() -> Backend:
    """Return the backend ``docker``, or skip the tests: they build from an image that nothing can be pulled for."""
    backend = DockerBackend(build_args={"BASE": BASE})
    backend.check(task_of("count-errors", "harbor"))
    with contextlib.closing(docker.from_env(timeout=60)) as client:
        try:
            client.images.get(BASE)
        except docker.errors.ImageNotFound:
            pytest.skip(f"the engine has no image {BASE}; run scripts/docker_engine.sh image")
    return backend


def local_backend() -> Backend:
    """Return the backend ``local``."""
    backend = LocalBackend()
    backend.check(task_of("count-errors", "harbor"))
    return backend


@pytest.fixture(scope="module", params=[docker_backend, local_backend], ids=["docker", "local"])
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """Give each backend that can be had here."""
    yield from had(request.param)


@pytest.fixture(scope="module", params=[local_backend, *[docker_backend] * EVERY], ids=["local", *["docker"] * EVERY])
def thorough_backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """Give the quick backend, and the other when all is to be tried."""
    yield from had(request.param)


def had(make: Callable[[], Backend]) -> Iterator[Backend]:
    """Give a backend, or skip the tests where it cannot be had."""
    try:
        found = make()
    except (EngineError, docker.errors.DockerException) as error:
        pytest.skip(str(error))
    yield found
    found.close()


@functools.cache
def task_of(name: str, form: str) -> Task:
    """Return a task in a format."""
    return read_task(DATA / form / name)


def judged(backend: Backend, task: Task, script: Path) -> Verdict:
    """Return the verdict on what a script does in a new machine."""
    with backend.start(task, LIMITS) as machine:
        machine.put({"/solution.sh": script})
        done = machine.run(["bash", "/solution.sh"], timeout_s=60.0)
        assert done.exit_code is not None, done.output
        machine.remove_files(["/solution.sh"])
        return verify(machine, task, task.steps[0], backend=backend, limits=LIMITS)


def failed(verdict: Verdict) -> set[str]:
    """Return the names of the checks that failed."""
    assert verdict.problem is None, (verdict.problem, verdict.detail, verdict.output)
    return {test.name for test in verdict.tests if not test.passed}


def tried(*, thorough: bool) -> list[object]:
    """Return the pairs of a task and a format that are tried: one for each task, or those that this leaves."""
    pairs = []
    for number, source in enumerate(SOURCES):
        for place, form in enumerate(FORMATS):
            if (number % 2 == place) != thorough:
                pairs.append(pytest.param(source, form, id=f"{source.name}-{form}"))
    return pairs


def check_reference(backend: Backend, source: build.Source, form: str) -> None:
    """See that a task is not solved by doing nothing, and is by its reference solution."""
    task = task_of(source.name, form)
    step = task.steps[0]
    with backend.start(task, LIMITS) as machine:
        before = verify(machine, task, step, backend=backend, limits=LIMITS)
    assert failed(before)
    assert not before.passed
    assert before.score < 1
    with backend.start(task, LIMITS) as machine:
        done = solve(machine, step, timeout_s=60.0)
        assert done.exit_code == 0, done.output
        after = verify(machine, task, step, backend=backend, limits=LIMITS)
    assert failed(after) == set(), after.output
    assert after.passed
    assert after.score == 1
    assert {test.name for test in after.tests} == {test.name for test in before.tests}


@pytest.mark.parametrize(("source", "form"), tried(thorough=False))
def test_only_the_reference_solution_passes(backend: Backend, source: build.Source, form: str):
    """Doing nothing fails, and what the task ships as its solution passes."""
    check_reference(backend, source, form)


@pytest.mark.thorough
@pytest.mark.parametrize(("source", "form"), tried(thorough=True))
def test_only_the_reference_solution_passes_in_the_other_format(
    thorough_backend: Backend, source: build.Source, form: str
):
    """The same holds in the other format."""
    check_reference(thorough_backend, source, form)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("source", "wrong", "form"),
    [
        pytest.param(source, wrong, FORMATS[number % 2], id=f"{source.name}-{wrong}")
        for number, source in enumerate(SOURCES)
        for wrong in source.wrong()
    ],
)
def test_a_wrong_solution_fails_by_the_right_checks(
    thorough_backend: Backend, source: build.Source, wrong: str, form: str
):
    """A plausible mistake or a shortcut fails, by exactly the checks that it names."""
    path = source.wrong()[wrong]
    verdict = judged(thorough_backend, task_of(source.name, form), path)
    assert failed(verdict) == build.caught_by(path), verdict.output
    assert not verdict.passed


FORGER = """\
cp /bin/bash /app/root-shell
chmod 4755 /app/root-shell
cat >/app/due.py <<'PYTHON'
import os
import subprocess

FORGE = (
    "echo '{\\"reward\\": 1}' >/logs/verifier/reward.json; echo 1 >/logs/verifier/reward.txt;"
    " echo 'def test_the_example(): pass' >/tests/checks.py; kill -9 %d; id -u >>/tmp/forged"
) % os.getppid()
subprocess.run(["bash", "-c", FORGE])
subprocess.run(["/app/root-shell", "-p", "-c", FORGE])
PYTHON
"""


@pytest.mark.parametrize("form", FORMATS)
def test_a_program_that_checks_run_cannot_reach_them(backend: Backend, form: str):
    """In a container it runs as nobody: it writes no reward, and neither changes nor ends the checks."""
    if backend.name != "docker":
        pytest.skip("a sandbox has one user, as whom all programs run")
    task = task_of("due-jobs", form)
    with backend.start(task, LIMITS) as machine:
        done = machine.run(["bash", "-c", FORGER], timeout_s=60.0)
        assert done.exit_code == 0, done.output
        verdict = verify(machine, task, task.steps[0], backend=backend, limits=LIMITS, where="machine")
        assert len(failed(verdict)) == len(verdict.tests) == 7
        assert not verdict.passed
        assert set(machine.get("/tmp/forged")[""].split()) == {b"65534"}
