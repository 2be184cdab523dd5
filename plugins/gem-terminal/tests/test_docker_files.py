"""Files into and out of a machine, with an agent that has put links and worse where they belong."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, machine, needs_engine, run_label, say, task

from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.docker.machine import DockerMachine
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "machine", "run_label", "task"]
pytestmark = needs_engine
INSIDE = {"run.sh": b"echo run\n", "deep/data": b"\0\xff"}


@pytest.fixture
def tests(tmp_path: Path) -> Path:
    """Give a folder of a host."""
    folder = tmp_path / "tests"
    (folder / "deep").mkdir(parents=True)
    for name, content in INSIDE.items():
        (folder / name).write_bytes(content)
    (folder / "run.sh").chmod(0o700)
    (folder / "link").symlink_to("run.sh")
    return folder


def test_files_and_folders_come_and_go(machine: DockerMachine, tests: Path) -> None:
    """As root's, readable by all, links kept; a folder is replaced whole, one on the way stays as it is."""
    say(
        machine,
        "mkdir -p /tests/deep && echo evil > /tests/deep/conftest.py; mkdir -m 700 /srv/kim; chown nobody /srv/kim",
    )
    machine.put({"/tests": tests, "/one/two/three": b"3", "/app/greeting": tests / "run.sh", "/srv/kim/x": b"x"})
    assert machine.get("/tests") == INSIDE
    assert machine.get("/one") == {"two/three": b"3"}
    assert machine.get("/app/greeting") == {"": b"echo run\n"}
    assert machine.get("/nothing/here") == {}
    said = say(
        machine, "stat -c '%a %U' /tests /tests/run.sh /tests/deep/data /one/two/three /srv/kim; readlink /tests/link"
    )
    assert said.splitlines() == ["755 root", "744 root", "644 root", "644 root", "700 nobody", "run.sh"]
    machine.put({"/bin/tool": b"#!/bin/sh\necho tool\n"}, mode=0o755)
    assert say(machine, "readlink /bin; /usr/bin/tool").splitlines() == ["usr/bin", "tool"]
    say(machine, "mkdir /out && echo a > /out/a && truncate -s 60M /out/m")
    assert machine.get("/out", most_bytes=1000) in ({"a": b"a\n"}, {})
    assert [machine.get("/out/a", most_bytes=most) for most in (2, 1)] == [{"": b"a\n"}, {}]


TRAPS = ["ln -s /etc /tests", "echo file > /tests", "mkfifo /tests", "ln -s /tests /tests", "mkdir -p /tests/run.sh/x"]


def test_what_the_agent_has_put_in_the_place_of_a_folder_is_replaced(machine: DockerMachine, tests: Path) -> None:
    """And a link of its not followed; a file on the way to files is the agent's doing."""
    for trap in TRAPS:
        say(machine, f"rm -rf /tests; cp /etc/passwd /before && {trap}")
        machine.put({"/tests": tests})
        assert machine.get("/tests") == INSIDE
        say(machine, "cmp /etc/passwd /before && ! test -e /etc/run.sh && ! test -e /etc/data")
    say(machine, "echo file > /logs")
    with pytest.raises(MachineLostError) as caught:
        machine.put({"/logs/verifier/x": b"x"})
    assert caught.value.by_agent is True


def test_saved_files_stand_elsewhere_as_they_were(backend: DockerBackend, task: Task, machine: DockerMachine) -> None:
    """With owners, permissions and links of both kinds, in place of what was there; a link at the path is followed."""
    look = "cd %s && find . -type d -printf '%%p %%m %%U\\n' -o -printf '%%p %%y %%m %%U %%l %%n\\n' | sort"
    say(
        machine,
        "useradd -m kim; mkdir -p d/e; echo hi > d/e/f; ln d/e/f hard; ln -s greeting soft; ln -s / root; mkfifo fifo;"
        "chown kim d/e/f; chmod 4755 d/e/f; chmod 1777 d; chown kim .; ln -s /app /link; ln -s /none /dead;"
        "ln -s /loop /loop; truncate -s 60M /big",
    )
    with backend.start(task, SMALL) as other:
        for path, here in (("/app", "/app"), ("/link", "/opt/other/place")):
            say(other, f"mkdir -p {here} && touch {here}/old")
            archive = BytesIO()
            assert machine.save(path, archive, most_bytes=1_000_000)
            archive.seek(0)
            other.load(here, archive)
            assert say(other, look % here) == say(machine, look % "/app")
        archive = BytesIO()
        assert machine.save("/app/d/e/f", archive, most_bytes=1_000_000)
        archive.seek(0)
        other.load("/app/soft", archive)
        assert other.get("/app/soft") == {"": b"hi\n"}
    for path in ("/none", "/dead", "/loop", "/app/none/none"):
        assert not machine.save(path, BytesIO(), most_bytes=1000)
    with pytest.raises(MachineLostError, match="more than 1 MB") as caught:
        machine.save("/big", BytesIO(), most_bytes=1_000_000)
    assert caught.value.by_agent is True


def test_getting_and_removing_follow_no_links(machine: DockerMachine) -> None:
    """Neither at the path nor below; what is not there is no error, a remover that is broken is the agent's doing."""
    say(machine, "mkdir -p /real /full/deep && echo 1 > /real/x && ln -s /real /way && touch /full/deep/x")
    say(machine, "ln -s /etc/passwd /real/link && mkfifo /real/pipe")
    assert (machine.get("/way"), machine.get("/real")) == ({}, {"x": b"1\n"})
    machine.remove_files(["/way", "/full", "/none/at/all"])
    assert machine.get("/real") == {"x": b"1\n"}
    assert say(machine, "ls -d /way /full 2>/dev/null; true") == ""
    say(machine, "cp /bin/false /bin/rm; touch /x")
    with pytest.raises(MachineLostError) as caught:
        machine.remove_files(["/x"])
    assert caught.value.by_agent is True
