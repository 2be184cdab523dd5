"""A real engine for the attacks on verifiers: one image with pytest in it, and tasks of Harbor's kind."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError
from gem_terminal.tasks.task import Container, Environment, Step, Task, Verifier

BASE = "gem-python:base"
LIMITS = Limits(cpus=1.0, memory_mb=512, processes=96, storage_mb=512)
TIMEOUT_S = 60.0

_DOCKERFILE = """ARG BASE=python:3.12-slim-bookworm
FROM ${BASE}
COPY packages /usr/local/lib/python3.11/dist-packages
WORKDIR /app
"""
_PYTEST = ("pytest", "_pytest", "pluggy", "iniconfig", "packaging", "pygments", "py")

TEST_SH = """cd /app
if { %s; }; then echo 1 > /logs/verifier/reward.txt; else echo 0 > /logs/verifier/reward.txt; fi
"""
CHECKS = {
    "cat": '[ "$(cat answer)" = 42 ]',
    "python": "python3 /tests/check.py",
    "pytest": "python3 -m pytest -q -p no:cacheprovider /tests/test_answer.py",
    "server": "python3 /tests/ask.py",
    "program": "timeout 20 python3 main.py; python3 /tests/check.py",
    "hang": "sleep 1000",
}
FILES = {
    "check.py": "import json, random, sys\nsys.exit(0 if json.loads(open('/app/answer').read()) == 42 else 1)\n",
    "test_answer.py": "import json\ndef test_answer():\n    assert json.loads(open('/app/answer').read()) == 42\n",
    "ask.py": "import sys, urllib.request as u\nsys.exit(u.urlopen('http://127.0.0.1:8765/answer').read() != b'42')\n",
}


@pytest.fixture(scope="module")
def engine() -> Iterator[DockerBackend]:
    """A backend on a real engine, which has the base image."""
    backend = DockerBackend(build_args={"BASE": BASE})
    try:
        backend.engine.client.image(BASE)
    except Exception as error:
        if not isinstance(error, EngineError) and "No such image" not in str(error):
            raise
        pytest.skip(f"needs a container engine with the image {BASE}; see CONTRIBUTING.md")
    yield backend
    backend.close()


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that the image is built from: the base with the pytest that runs these tests."""
    folder = tmp_path_factory.mktemp("context")
    (folder / "Dockerfile").write_text(_DOCKERFILE)
    for name in _PYTEST:
        found = importlib.util.find_spec(name)
        assert found is not None
        assert found.origin is not None
        source = Path(found.origin)
        if found.submodule_search_locations is None:
            shutil.copy(source, folder / "packages")
        else:
            shutil.copytree(source.parent, folder / "packages" / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def make_task(context: Path, folder: Path, checks: Mapping[str, str] = CHECKS) -> Task:
    """Make a task with a step for each check; a step passes if the answer is 42."""
    steps = []
    for name, check in checks.items():
        tests = folder / name
        tests.mkdir(exist_ok=True)
        (tests / "test.sh").write_text(TEST_SH % check)
        for file, text in FILES.items():
            (tests / file).write_text(text)
        verifier = Verifier({"/tests": tests}, ("bash", "/tests/test.sh"), TIMEOUT_S, "reward_file")
        steps.append(Step(name, "write 42 into /app/answer", verifier))
    # The digest names a version of the task to the cache of trials: these are new ones each time.
    return Task("answer", folder, "harbor", Environment(Container(context=context)), tuple(steps), digest=f"d-{folder}")


def step_of(task: Task, name: str, timeout_s: float = TIMEOUT_S) -> Step:
    """Return a step by its name."""
    step = next(step for step in task.steps if step.name == name)
    return replace(step, verifier=replace(step.verifier, timeout_s=timeout_s))
