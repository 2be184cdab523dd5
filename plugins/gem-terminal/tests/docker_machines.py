"""Tasks and a backend for the tests on a real container engine; without one they are skipped, with the reason."""

from __future__ import annotations

import functools
import os
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import docker
import pytest

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.docker.engine import Engine
from gem_terminal.backends.docker.sweeping import RUN
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError
from gem_terminal.tasks.reading import scan
from gem_terminal.tasks.task import Container, Environment, Healthcheck, Network, Step, Task, Verifier

if TYPE_CHECKING:
    from gem_terminal.backends.docker.machine import DockerMachine

BASE = os.environ.get("GEM_TERMINAL_BASE_IMAGE", "gem-python:base")
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


os.environ.setdefault("GEM_TERMINAL_BASE_IMAGE", BASE)
needs_engine = pytest.mark.skipif(bool(why_not()), reason=why_not())


def make_task(
    folder: Path,
    *,
    dockerfile: str = DOCKERFILE,
    main: Container | None = None,
    services: dict[str, Container] | None = None,
    network: Network | None = None,
    build_timeout_s: float = 120.0,
) -> Task:
    """Return a task whose image is built from a folder."""
    folder.mkdir(exist_ok=True)
    (folder / "Dockerfile").write_text(dockerfile)
    verifier = Verifier(files={}, command=("true",), timeout_s=10, result="output")
    environment = Environment(main or Container(context=folder), services or {}, network, (), build_timeout_s)
    return Task("trial", folder, "harbor", environment, (Step("", "Do it.", verifier),), digest=scan(folder))


def ready(*command: str, retries: int = 50) -> Healthcheck:
    """Return a healthcheck that tries often."""
    return Healthcheck(command, interval_s=0.05, timeout_s=10, retries=retries)


def variables(run: str) -> dict[str, str]:
    """Return the variables of a process whose things bear a label of their own."""
    return {**os.environ, "GEM_TERMINAL_RUN": run}


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


def remove_images(names: Sequence[str]) -> None:
    """Remove images that a test has built."""
    client = Engine().client
    for name in names:
        try:
            client.remove_image(name, force=True)
        except docker.errors.APIError:
            continue
    client.close()


@pytest.fixture(scope="module")
def run_label() -> Iterator[str]:
    """Mark all that a module makes, and find nothing of it in the end."""
    before = os.environ.get("GEM_TERMINAL_RUN")
    run = f"test-{os.getpid()}-{secrets.token_hex(4)}"
    os.environ["GEM_TERMINAL_RUN"] = run
    yield run
    if before is None:
        del os.environ["GEM_TERMINAL_RUN"]
    else:
        os.environ["GEM_TERMINAL_RUN"] = before
    assert left(run) == []


@pytest.fixture(scope="module")
def backend(run_label: str) -> Iterator[DockerBackend]:
    """Give a backend whose machines all are removed in the end, and its images."""
    backend = DockerBackend(build_args={"BASE": BASE})
    yield backend
    backend.close()
    remove_images(sorted(backend.images.built))


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    """Give a task with one container."""
    return make_task(tmp_path_factory.mktemp("task"))


@pytest.fixture
def machine(backend: DockerBackend, task: Task) -> Iterator[DockerMachine]:
    """Give a machine that nothing has touched."""
    with backend.start(task, SMALL) as machine:
        yield machine


def say(machine: DockerMachine, script: str, *, user: str = "", timeout_s: float = 30.0) -> str:
    """Run a script, and return what it wrote; it has to succeed."""
    done = machine.run(["sh", "-c", script], user=user, timeout_s=timeout_s)
    assert done.exit_code == 0, done
    return done.output.decode()
