"""Building for the backend ``local``: what a Dockerfile leaves in a machine, its cache, and how it fails."""

from __future__ import annotations

import fcntl
import os
import tarfile
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from local_sandboxes import backend, shell, wait_for, write_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import BuildError, EngineError, TaskError
from gem_terminal.tasks.task import Container, Environment, Healthcheck, Verifier

if TYPE_CHECKING:
    from gem_terminal.backends.local.backend import LocalBackend

__all__ = ["backend"]

DOCKERFILE = """\
ARG BASE=python:3.12-slim-bookworm
FROM ${BASE}
ENV NAME=value
WORKDIR /app
COPY . .
COPY --chmod=700 one.txt named.txt
COPY one.txt *.md docs/
COPY one.txt docs
ADD archive.tar.gz /unpacked/
RUN echo "$NAME $PWD" > ran && chmod 000 one.txt && ln -s ran link && mkdir -p /data/deep
RUN <<EOF
import os
EOF
"""


def test_a_machine_has_what_its_dockerfile_makes(backend: LocalBackend, tmp_path: Path) -> None:
    context = tmp_path / "task" / "environment"
    (context / "folder").mkdir(parents=True)
    (context / "folder" / "two.txt").write_text("two", "utf-8")
    (context / "one.txt").write_text("one", "utf-8")
    (context / "read.md").write_text("read", "utf-8")
    (context / "left.tmp").write_text("left out", "utf-8")
    (context / ".dockerignore").write_text("*.tmp\nDockerfile\n", "utf-8")
    (context / "to-two").symlink_to("folder/two.txt")
    with tarfile.open(context / "archive.tar.gz", "w:gz") as archive:
        archive.add(context / "folder" / "two.txt", "inner/two.txt")
    text = DOCKERFILE.replace("RUN <<EOF\nimport os", "RUN <<EOF\necho from a script > /data/script")
    task = write_task(tmp_path, text, container={"env": {"OTHER": "2"}})
    with backend.start(task, Limits()) as machine:
        assert shell(
            machine, "pwd; echo $NAME $OTHER; cat ran to-two /data/script /unpacked/inner/two.txt; readlink link"
        ) == ("/app\nvalue 2\nvalue /app\ntwofrom a script\ntworan\n")
        assert shell(machine, "ls -A; ls docs; stat -c %a one.txt named.txt; cat docs/one.txt; test -d /data/deep") == (
            ".dockerignore\narchive.tar.gz\ndocs\nfolder\nlink\nnamed.txt\none.txt\nran\nread.md\nto-two\n"
            "one.txt\nread.md\n0\n700\none"
        )
        assert machine.changed() == {}


def test_a_template_is_made_once_and_machines_share_nothing(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, "FROM debian\nRUN date +%N > /when\n")
    lines: list[str] = []
    backend.build(task, on_line=lines.append)
    backend.build(task, on_line=lines.append)
    assert lines == ["[line 2] RUN date +%N > /when"]
    with backend.start(task, Limits()) as one, backend.start(task, Limits()) as other:
        shell(one, "echo mine >> /when")
        assert shell(one, "head -n 1 /when") == shell(other, "cat /when")
    with backend.start(task, Limits()) as again:
        before = shell(again, "cat /when")
        assert "mine" not in before
    backend.build(task, fresh=True)
    with backend.start(task, Limits()) as anew:
        assert shell(anew, "cat /when") != before


def test_two_threads_make_a_template_once(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, "FROM debian\nRUN sleep 0.3\n")
    lines: list[str] = []
    threads = [threading.Thread(target=backend.build, args=(task,), kwargs={"on_line": lines.append}) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lines == ["[line 2] RUN sleep 0.3"]


def test_machines_of_one_template_are_started_at_once(backend: LocalBackend, tmp_path: Path) -> None:
    """None waits until another has copied it: who copies it holds its lock, together with others."""
    task = write_task(tmp_path)
    backend.build(task)
    (lock,) = (tmp_path / "scratch" / "templates").glob("*.lock")
    started = threading.Event()

    def start() -> None:
        with backend.start(task, Limits()):
            started.set()

    with lock.open("rb") as copying:
        fcntl.flock(copying, fcntl.LOCK_SH)
        thread = threading.Thread(target=start, daemon=True)
        thread.start()
        assert started.wait(60)
        thread.join(60)


def test_templates_are_removed_when_asked_for(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path)
    with backend.start(task, Limits()) as machine:
        assert backend.clean() == []
        assert [line.split()[0] for line in backend.clean(images=True)] == ["template"]
        assert shell(machine, "echo still there") == "still there\n"
    with backend.start(task, Limits()) as machine:
        assert shell(machine, "echo again") == "again\n"


def test_a_command_that_fails_is_quoted_with_what_it_said(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, "FROM debian\nRUN echo fine\nRUN echo broken >&2; exit 3\n")
    with pytest.raises(BuildError) as caught:
        backend.start(task, Limits())
    assert str(caught.value) == (
        "the image of task was not built: line 3 of its Dockerfile: RUN ended with exit code 3; the log ends with:\n"
        "[line 2] RUN echo fine\nfine\n[line 3] RUN echo broken >&2; exit 3\nbroken"
    )
    assert caught.value.log.endswith("broken")


@pytest.mark.thorough
def test_a_build_out_of_time_is_stopped(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, "FROM debian\nRUN echo begun; sleep 1000\n", build_timeout_s=2.0)
    with pytest.raises(BuildError, match=r"the time for building was over \(build_timeout_s\)"):
        backend.build(task)


@pytest.mark.parametrize(
    ("dockerfile", "words"),
    [
        ("COPY missing /x", r"line 2 of its Dockerfile: 'missing' is not in "),
        ("COPY ../../secret /x", r"'../../secret' is not in "),
        ("COPY no*thing /x", r"is not in "),
        (
            "COPY Dockerfile /usr/lib/x",
            r"/usr/lib/x is the host's, and read-only in a sandbox: use the backend 'docker'",
        ),
        ("WORKDIR /usr/src/app", r"/usr/src/app is the host's"),
        ("COPY link /x", r"leads out of"),
    ],
)
def test_files_that_cannot_be_copied_are_named(
    backend: LocalBackend, tmp_path: Path, dockerfile: str, words: str
) -> None:
    (tmp_path / "secret").write_text("secret", "utf-8")
    (tmp_path / "task" / "environment").mkdir(parents=True)
    (tmp_path / "task" / "environment" / "link").symlink_to(tmp_path / "secret")
    with pytest.raises((BuildError, TaskError), match=words):
        backend.build(write_task(tmp_path, f"FROM debian\n{dockerfile}\n"))


def test_what_is_built_sees_nothing_of_the_host(backend: LocalBackend, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret", "utf-8")
    here = f"/proc/{os.getpid()}/./root/tmp"
    task = write_task(tmp_path, f"FROM debian\nRUN ! cat {tmp_path}/secret && test ! -e {here}\n")
    backend.build(task)


def test_what_the_image_runs_is_started_and_is_not_the_agents(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, 'FROM debian\nENTRYPOINT ["sh", "-c", "echo $$ > /run/up; exec sleep 1001"]\n')
    with backend.start(task, Limits()) as machine:
        wait_for(machine, "pgrep -fx 'sleep 1001'")
        assert machine.processes() == []


@pytest.mark.parametrize(
    "command", [("sleep", "infinity"), ("sh", "-c", "sleep infinity"), ("tail", "-f", "/dev/null")]
)
def test_what_only_keeps_a_container_there_is_not_started(
    backend: LocalBackend, tmp_path: Path, command: tuple[str, ...]
) -> None:
    with backend.start(write_task(tmp_path, container={"command": command}), Limits()) as machine:
        assert shell(machine, f"pgrep -fx '{command[-1]}|sleep infinity|tail -f /dev/null' || echo none") == "none\n"


def test_a_machine_is_ready_when_its_healthcheck_passes(backend: LocalBackend, tmp_path: Path) -> None:
    check = Healthcheck(("sh", "-c", "echo x >> /tries; test $(wc -l < /tries) -ge 3"), interval_s=0.01)
    with backend.start(write_task(tmp_path, container={"healthcheck": check}), Limits()) as machine:
        assert shell(machine, "wc -l < /tries") == "3\n"


def test_a_healthcheck_that_never_passes_is_quoted(backend: LocalBackend, tmp_path: Path) -> None:
    check = Healthcheck(("sh", "-c", "echo not yet; false"), interval_s=0.01, retries=2)
    with pytest.raises(EngineError, match=r"^task: its healthcheck .* does not pass: not yet$"):
        backend.start(write_task(tmp_path, container={"healthcheck": check}), Limits())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"network": "public"}, "task asks for the network 'public', which a sandbox lacks: use the backend 'docker'"),
        ({"services": {"db": Container(image="debian")}}, "task asks for several containers (db), which"),
        ({"unsupported": ("graphics cards",)}, "task asks for graphics cards, which"),
        ({"main": Container(image="debian", user="agent")}, "task asks for the user 'agent', which"),
        ({"main": Container(image="postgres")}, "its image is 'postgres'"),
    ],
)
def test_a_task_that_needs_docker_is_refused(
    backend: LocalBackend, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    task = write_task(tmp_path)
    task = replace(task, environment=replace(task.environment, **change))  # type: ignore[arg-type]
    with pytest.raises(TaskError) as caught:
        backend.check(task)
    assert words in str(caught.value)
    with pytest.raises(TaskError):
        backend.start(task, Limits())


def test_a_network_may_be_overruled(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path, network="public")
    with backend.start(task, Limits(network="none")) as machine:
        assert shell(machine, "echo started") == "started\n"
    with pytest.raises(TaskError, match="the network 'public'"):
        backend.start(write_task(tmp_path), Limits(network="public"))


def test_a_verifiers_own_environment_is_built_and_started(backend: LocalBackend, tmp_path: Path) -> None:
    own = write_task(tmp_path, "FROM debian\nRUN echo own > /which\n", name="own").environment
    task = write_task(tmp_path, "FROM debian\nRUN echo agent > /which\n")
    verifier = Verifier({}, ("true",), 10.0, "reward_file", environment=own)
    task = replace(task, steps=(replace(task.steps[0], verifier=verifier),))
    backend.check(task)
    with backend.start(task, Limits()) as agent, backend.start(task, Limits(), environment=own) as judge:
        assert (shell(agent, "cat /which"), shell(judge, "cat /which")) == ("agent\n", "own\n")


def test_the_environment_of_an_image_alone_is_a_bare_machine(backend: LocalBackend, tmp_path: Path) -> None:
    task = replace(write_task(tmp_path), environment=Environment(Container(image="python:3.12", workdir="/srv")))
    with backend.start(task, Limits()) as machine:
        assert shell(machine, "pwd; python -c 'print(1)'") == "/srv\n1\n"
