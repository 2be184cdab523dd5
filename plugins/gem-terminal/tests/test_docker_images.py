"""Images: built once for the same task, and errors of a build that say what to do."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import pytest
from docker_machines import BASE, DOCKERFILE, SMALL, backend, make_task, needs_engine, run_label, say, soon

from gem_terminal.backends.docker import images
from gem_terminal.errors import BuildError, EngineError
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "run_label"]
pytestmark = needs_engine
NOWHERE = "127.0.0.1:1/gem/none:latest"


def built(backend: DockerBackend, task: Task) -> str:
    """Return the image of a task, built if it is not there."""
    environment = task.environment
    return backend.images.image(environment.main, task, timeout_s=environment.build_timeout_s)


@pytest.mark.parametrize("program", ["/usr/local/bin/docker", "/usr/bin/docker", None])
def test_any_client_builds(
    backend: DockerBackend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str | None, run_label: str
) -> None:
    """An old one, and a new one, with or without BuildKit; none is an error that says what to install."""
    if program and not os.path.exists(program):
        pytest.skip(f"there is no {program}")
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV CLIENT={program}{run_label}\n")
    monkeypatch.setattr(images, "which", lambda _: program)
    images.builder.cache_clear()
    if program:
        built(backend, task)
    else:
        with pytest.raises(EngineError, match="install Docker's client"):
            built(backend, task)
    images.builder.cache_clear()


def test_an_image_is_built_once_for_all_who_ask(
    backend: DockerBackend, tmp_path: Path, run_label: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In several threads at the same time; again only where it was removed."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV ONCE={run_label}\n")
    builds: list[object] = []
    builder = images.builder
    monkeypatch.setattr(images, "builder", lambda podman: (builds.append(podman), builder(podman))[1])
    with ThreadPoolExecutor(6) as pool:
        names = set(pool.map(lambda _: built(backend, task), range(6)))
    assert names == {built(backend, task)}
    assert len(builds) == 1
    backend.start(task, SMALL).remove()
    backend.engine.client.remove_image(built(backend, task), force=True)
    with backend.start(task, SMALL) as machine:
        assert say(machine, "echo $ONCE") == f"{run_label}\n"


@pytest.mark.parametrize(
    ("dockerfile", "more", "said"),
    [
        (None, {}, "Look at .*Dockerfile"),
        ("ARG BASE\nFROM ${BASE}\nRUN : LABEL; echo one-$((40+2))\nRUN exit 9\n", {}, r"non-zero code: 9(.|\n)*one-42"),
        (f"FROM {NOWHERE}\n", {}, "'docker pull' it, or name one"),
        (DOCKERFILE, {"main": Container(image=NOWHERE)}, f"Run 'docker pull {NOWHERE}'"),
    ],
)
def test_a_build_that_fails_says_what_to_do(
    backend: DockerBackend, tmp_path: Path, run_label: str, dockerfile: str | None, more: Any, said: str
) -> None:
    """With the end of its log."""
    task = make_task(
        tmp_path, dockerfile=f"{dockerfile or DOCKERFILE}ENV NEW=LABEL\n".replace("LABEL", run_label), **more
    )
    if dockerfile is None:
        (tmp_path / "Dockerfile").unlink()
    with pytest.raises((BuildError, EngineError), match=said):
        built(backend, task)


@pytest.mark.thorough
def test_a_build_that_takes_too_long_is_ended(backend: DockerBackend, tmp_path: Path) -> None:
    """Also when it says nothing; what ran for it runs no more."""
    dockerfile = "ARG BASE\nFROM ${BASE}\nRUN echo begin; sleep 1234\n"
    with pytest.raises(BuildError, match="longer than 5 s"):
        built(backend, make_task(tmp_path, dockerfile=dockerfile, build_timeout_s=5))
    client = backend.engine.client
    assert soon(lambda: not any("sleep 1234" in row["Command"] for row in client.containers(all=True)))


@pytest.mark.parametrize(("image", "shown"), [(NOWHERE, "yes"), (BASE, "")])
def test_a_dockerfile_takes_the_place_of_an_image_that_is_missing(
    backend: DockerBackend, tmp_path: Path, image: str, shown: str
) -> None:
    """Which would come first: where it is there, nothing is built."""
    main = Container(image=image, context=tmp_path)
    with backend.start(make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV BUILT=yes\n", main=main), SMALL) as machine:
        assert say(machine, "echo $BUILT") == f"{shown}\n"
