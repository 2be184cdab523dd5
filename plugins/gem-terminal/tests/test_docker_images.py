"""Images: built once for the same task, and errors of a build that say what to do."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from docker_machines import BASE, DOCKERFILE, SMALL, backend, make_task, needs_engine, run_label, say

from gem_terminal.backends.docker import images
from gem_terminal.errors import BuildError, EngineError
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "run_label"]
pytestmark = needs_engine


def built(backend: DockerBackend, task: Task) -> str:
    """Return the image of a task, built if it is not there."""
    environment = task.environment
    return backend.images.image(environment.main, task, timeout_s=environment.build_timeout_s)


def test_a_missing_dockerfile_is_named(backend: DockerBackend, tmp_path: Path, run_label: str) -> None:
    """With where it was looked for."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV MISSING={run_label}\n")
    (tmp_path / "Dockerfile").unlink()
    with pytest.raises(BuildError, match=r"the files of an image cannot be read: .*Look at .*Dockerfile"):
        built(backend, task)


def test_no_client_says_what_to_install(
    backend: DockerBackend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_label: str
) -> None:
    """Images are built by Docker's own command."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV NEW={run_label}\n")
    monkeypatch.setattr(images, "which", lambda _: None)
    images.builder.cache_clear()
    with pytest.raises(EngineError, match="install Docker's client"):
        built(backend, task)


@pytest.mark.parametrize("program", ["/usr/local/bin/docker", "/usr/bin/docker"])
def test_any_client_builds(
    backend: DockerBackend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, run_label: str
) -> None:
    """An old one, and a new one, with or without BuildKit."""
    if not os.path.exists(program):
        pytest.skip(f"there is no {program}")
    monkeypatch.setattr(images, "which", lambda _: program)
    images.builder.cache_clear()
    built(backend, make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV CLIENT={program}{run_label}\n"))
    images.builder.cache_clear()


def test_an_image_is_built_once_for_all_who_ask(
    backend: DockerBackend, tmp_path: Path, run_label: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In several threads at the same time, and never again for the same task."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV ONCE={run_label}\n")
    builds: list[object] = []
    builder = images.builder
    monkeypatch.setattr(images, "builder", lambda podman: (builds.append(podman), builder(podman))[1])
    with ThreadPoolExecutor(6) as pool:
        names = set(pool.map(lambda _: built(backend, task), range(6)))
    assert names == {built(backend, task)}
    assert len(builds) == 1


def test_an_image_that_was_removed_is_built_again(backend: DockerBackend, tmp_path: Path, run_label: str) -> None:
    """At the next start, without anybody's doing."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV AGAIN={run_label}\n")
    backend.start(task, SMALL).remove()
    backend.engine.client.remove_image(built(backend, task), force=True)
    with backend.start(task, SMALL) as machine:
        assert say(machine, "echo $AGAIN") == f"{run_label}\n"


def test_a_build_that_fails_ends_with_its_log(backend: DockerBackend, tmp_path: Path, run_label: str) -> None:
    """And says what to do."""
    dockerfile = f"ARG BASE\nFROM ${{BASE}}\nRUN : {run_label}; echo one-$((40+2))\nRUN echo bad; exit 9\n"
    task = make_task(tmp_path, dockerfile=dockerfile)
    with pytest.raises(
        BuildError, match=r"returned a non-zero code: 9\. Mend its Dockerfile\. The end of the log"
    ) as caught:
        built(backend, task)
    assert "one-42" in caught.value.log
    assert caught.value.log.splitlines()[-1].endswith("returned a non-zero code: 9")


@pytest.mark.thorough
def test_a_build_that_takes_too_long_is_ended(backend: DockerBackend, tmp_path: Path) -> None:
    """Also when it says nothing; what ran for it runs no more."""
    dockerfile = "ARG BASE\nFROM ${BASE}\nRUN echo begin; sleep 1234\n"
    task = make_task(tmp_path, dockerfile=dockerfile, build_timeout_s=5)
    with pytest.raises(BuildError, match=r"took longer than 5 s\. Raise the task's build_timeout_sec"):
        built(backend, task)
    client = backend.engine.client
    for _ in range(1000):
        if not any("sleep 1234" in row["Command"] for row in client.containers(all=True)):
            return
    pytest.fail("the build goes on")


def test_a_missing_base_image_says_how_to_name_another(backend: DockerBackend, tmp_path: Path) -> None:
    """Nothing can be pulled here."""
    task = make_task(tmp_path, dockerfile="FROM 127.0.0.1:1/gem/none:latest\n")
    with pytest.raises(BuildError, match="Its base image is not there: 'docker pull' it, or name one with"):
        built(backend, task)


def test_a_missing_image_says_how_to_get_it(backend: DockerBackend, tmp_path: Path) -> None:
    """One that the task names, and that is not built."""
    task = make_task(tmp_path, main=Container(image="127.0.0.1:1/gem/none:latest"))
    with pytest.raises(EngineError, match=r"Run 'docker pull 127\.0\.0\.1:1/gem/none:latest'"):
        built(backend, task)
    with backend.start(make_task(tmp_path, main=Container(image=BASE)), SMALL) as machine:
        assert say(machine, "echo fine") == "fine\n"


def test_a_dockerfile_takes_the_place_of_an_image_that_is_missing(backend: DockerBackend, tmp_path: Path) -> None:
    """Which would come first: where it is there, nothing is built."""
    dockerfile = f"{DOCKERFILE}ENV BUILT=yes\n"
    missing = Container(image="127.0.0.1:1/gem/none:latest", context=tmp_path)
    task = make_task(tmp_path, dockerfile=dockerfile, main=missing)
    with backend.start(task, SMALL) as machine:
        assert say(machine, "echo $BUILT") == "yes\n"
    there = make_task(tmp_path, dockerfile=dockerfile, main=Container(image=BASE, context=tmp_path))
    with backend.start(there, SMALL) as machine:
        assert say(machine, "echo $BUILT") == "\n"
