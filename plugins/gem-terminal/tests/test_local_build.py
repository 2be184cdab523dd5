"""Which tasks the backend ``local`` runs, what their machines begin with, and how preparing them fails."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from local_sandboxes import backend, scratch, shell, wait_for, write_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import BuildError, TaskError
from gem_terminal.tasks.task import Container, Environment, Healthcheck, Verifier

if TYPE_CHECKING:
    from gem_terminal.backends.local.backend import LocalBackend

__all__ = ["backend", "scratch"]


def test_a_machine_has_what_the_script_of_its_task_makes(backend: LocalBackend, tmp_path: Path) -> None:
    """In the task's working directory, with its variables; the script itself is gone."""
    script = 'cp "$0" "$(dirname "$0")/one.txt" .; echo "$NAME $PWD" > said; mkdir closed; chmod 000 closed'
    files = {"one.txt": "one\n"}
    task = write_task(tmp_path, script, files=files, container={"env": {"NAME": "value"}, "workdir": "/job/deep"})
    with backend.start(task, Limits()) as machine:
        assert shell(machine, "pwd; cat one.txt said; ls; stat -c '%U %a' closed; ls /opt") == (
            "/job/deep\none\nvalue /job/deep\nclosed\none.txt\nprepare.sh\nsaid\nroot 0\n"
        )


def test_a_task_is_prepared_once_and_its_machines_share_nothing(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, "date +%N > /when; echo prepared")
    lines: list[str] = []
    threads = [threading.Thread(target=backend.build, args=(task,), kwargs={"on_line": lines.append}) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lines == ["prepared"]
    with backend.start(task, Limits()) as one, backend.start(task, Limits()) as other:
        shell(one, "echo mine >> /when")
        before = shell(other, "cat /when")
        assert "mine" not in before
    backend.build(task, fresh=True)
    with backend.start(task, Limits()) as anew:
        assert shell(anew, "cat /when") != before


def test_a_script_that_fails_is_quoted_with_what_it_said(backend: LocalBackend, tmp_path: Path) -> None:
    with pytest.raises(BuildError) as caught:
        backend.start(write_task(tmp_path, "echo fine; echo broken >&2; exit 3"), Limits())
    assert str(caught.value) == (
        "the image of task was not built: setup/prepare.sh ended with exit code 3; the log ends with:\nfine\nbroken"
    )
    assert caught.value.log == "fine\nbroken"


@pytest.mark.thorough
def test_a_script_out_of_time_is_stopped(backend: LocalBackend, tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=r"took longer than its time \(build_timeout_s\)"):
        backend.build(write_task(tmp_path, "sleep 1000", build_timeout_s=0.5))


def test_what_the_container_runs_is_started(backend: LocalBackend, tmp_path: Path) -> None:
    """But what only keeps it there is not."""
    words = ("sh", "-c", 'echo "$0" > /run/up; exec sleep 1001')
    with backend.start(write_task(tmp_path, container={"entrypoint": words}), Limits()) as machine:
        wait_for(machine, "pgrep -fx 'sleep 1001'")
        assert shell(machine, "cat /run/up") == "sleep\n"
    keeps = ("sh", "-c", "sleep infinity")
    with backend.start(write_task(tmp_path, container={"command": keeps}), Limits()) as machine:
        assert machine.processes() == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"network": "public"}, "task needs Docker: it asks for the network 'public'"),
        ({"services": {"db": Container(image="debian")}}, "several containers (db)"),
        ({"unsupported": ("graphics cards",)}, "graphics cards"),
        ({"main": Container(image="debian", user="agent")}, "the user 'agent'"),
        ({"main": Container(image="postgres")}, "(beside its Dockerfile is no setup/prepare.sh, which a sandbox could"),
        ({"main": Container(healthcheck=Healthcheck(("true",)))}, "a healthcheck of its container"),
    ],
)
def test_a_task_that_needs_docker_is_refused(
    backend: LocalBackend, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    task = write_task(tmp_path)
    task = replace(task, environment=replace(task.environment, **change))  # type: ignore[arg-type]
    with pytest.raises(TaskError) as caught:
        backend.check(task)
    assert str(caught.value).startswith("task needs Docker: it asks for ")
    assert words in str(caught.value)
    with pytest.raises(TaskError):
        backend.start(task, Limits())


def test_a_network_may_be_overruled(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, network="public")
    with backend.start(task, Limits(network="none")) as machine:
        assert shell(machine, "echo started") == "started\n"
    with pytest.raises(TaskError, match="the network 'public'"):
        backend.start(write_task(tmp_path), Limits(network="public"))


@pytest.mark.thorough
def test_a_verifiers_own_environment_is_prepared_and_started(backend: LocalBackend, tmp_path: Path) -> None:
    own = write_task(tmp_path, "echo own > /which", name="task/own").environment
    task = write_task(tmp_path, "echo agent > /which")
    verifier = Verifier({}, ("true",), 10.0, "reward_file", environment=own)
    task = replace(task, steps=(replace(task.steps[0], verifier=verifier),))
    backend.check(task)
    with backend.start(task, Limits()) as agent, backend.start(task, Limits(), environment=own) as judge:
        assert (shell(agent, "cat /which"), shell(judge, "cat /which")) == ("agent\n", "own\n")
    unprepared = replace(verifier, environment=Environment(Container(image="debian")))
    with pytest.raises(TaskError, match="an image of its own"):
        backend.check(replace(task, steps=(replace(task.steps[0], verifier=unprepared),)))
