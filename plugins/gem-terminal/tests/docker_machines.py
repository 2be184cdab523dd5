"""Tasks and a backend for the tests on a real container engine; without one they are skipped, with the reason."""

from __future__ import annotations

import contextlib
import functools
import os
import secrets
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import docker
import pytest

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.docker.engine import Engine
from gem_terminal.backends.docker.sweeping import RUN
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError
from gem_terminal.tasks.reading import scan
from gem_terminal.tasks.task import Container, Environment, Step, Task, Verifier

if TYPE_CHECKING:
    from gem_terminal.backends.docker.machine import DockerMachine

BASE = os.environ.setdefault("GEM_TERMINAL_BASE_IMAGE", "gem-python:base")
DOCKERFILE = (
    "ARG BASE=python:3.12-slim-bookworm\nFROM ${BASE}\nRUN mkdir /app && echo hello > /app/greeting\nWORKDIR /app\n"
)
SMALL = Limits(memory_mb=256, processes=64, storage_mb=64)


@functools.cache
def why_not() -> str:
    """Return why there is no engine to test with; empty where there is one."""
    engine = Engine()
    try:
        engine.client.inspect_image(BASE)
    except EngineError as error:
        return f"no container engine: {error}"
    except docker.errors.NotFound:
        return f"the engine has no image {BASE!r}: name one with GEM_TERMINAL_BASE_IMAGE"
    finally:
        engine.close()
    return ""


needs_engine = pytest.mark.skipif(bool(why_not()), reason=why_not())


def make_task(
    folder: Path, *, dockerfile: str = DOCKERFILE, main: Container | None = None, services: Any = (), **more: Any
) -> Task:
    """Return a task whose image is built from a folder."""
    folder.mkdir(exist_ok=True)
    (folder / "Dockerfile").write_text(dockerfile)
    environment = Environment(main or Container(context=folder), dict(services), **{"build_timeout_s": 120.0, **more})
    step = Step("", "Do it.", Verifier(files={}, command=("true",), timeout_s=10, result="output"))
    return Task("trial", folder, "harbor", environment, (step,), digest=scan(folder))


def left(run: str) -> list[str]:
    """Return what of a run is on the engine."""
    client = Engine().client
    wanted = {"label": f"{RUN}={run}"}
    found = [f"container {row['Names']}" for row in client.containers(all=True, filters=wanted)]
    found += [f"volume {row['Name']}" for row in client.volumes(filters=wanted)["Volumes"] or []]
    found += [f"network {row['Name']}" for row in client.networks(filters=wanted)]
    found += [f"image {row['RepoTags']}" for row in client.images(filters=wanted)]
    client.close()
    return found


def soon(holds: Callable[[], object]) -> bool:
    """Whether something comes to hold: what was killed may take a moment to end under load."""
    deadline = time.monotonic() + 60
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.05)
    return bool(holds())


@pytest.fixture(scope="module")
def run_label() -> Iterator[str]:
    """Mark all that a module makes, and find nothing of it in the end."""
    run = f"test-{os.getpid()}-{secrets.token_hex(4)}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GEM_TERMINAL_RUN", run)
        yield run
    assert left(run) == []


@pytest.fixture(scope="module")
def backend(run_label: str) -> Iterator[DockerBackend]:
    """Give a backend whose machines all are removed in the end, and its images."""
    backend = DockerBackend(build_args={"BASE": BASE})
    yield backend
    backend.close()
    for name in sorted(backend.images.built):
        with contextlib.suppress(docker.errors.APIError), contextlib.closing(Engine().client) as client:
            client.remove_image(name, force=True)


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    """Give a task with one container."""
    return make_task(tmp_path_factory.mktemp("task"))


@pytest.fixture
def machine(backend: DockerBackend, task: Task) -> Iterator[DockerMachine]:
    """Give a machine that nothing has touched."""
    with backend.start(task, SMALL) as machine:
        yield machine


def say(machine: DockerMachine, script: str) -> str:
    """Run a script, and return what it wrote; it has to succeed."""
    done = machine.run(["sh", "-c", script], timeout_s=30.0)
    assert done.exit_code == 0, done
    return done.output.decode()
