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


@pytest.fixture
def tests(tmp_path: Path) -> Path:
    """Give a folder of a host."""
    folder = tmp_path / "tests"
    (folder / "deep").mkdir(parents=True)
    (folder / "run.sh").write_text("echo run\n")
    (folder / "run.sh").chmod(0o700)
    (folder / "deep" / "data").write_bytes(b"\0\xff")
    (folder / "link").symlink_to("run.sh")
    return folder


def test_files_and_folders_come_and_go(machine: DockerMachine, tests: Path) -> None:
    """As root's, readable by all, with what is in them; links of the host's folder stay links."""
    machine.put({"/tests": tests, "/one/two/three": b"3", "/app/greeting": tests / "run.sh"})
    assert machine.get("/tests") == {"run.sh": b"echo run\n", "deep/data": b"\0\xff"}
    assert machine.get("/one") == {"two/three": b"3"}
    assert machine.get("/app/greeting") == {"": b"echo run\n"}
    assert machine.get("/nothing/here") == {}
    said = say(machine, "stat -c '%a %U %n' /tests /tests/run.sh /tests/deep/data /one/two/three; readlink /tests/link")
    assert said.splitlines() == [
        "755 root /tests",
        "744 root /tests/run.sh",
        "644 root /tests/deep/data",
        "644 root /one/two/three",
        "run.sh",
    ]
    machine.put({"/bin2/x": b"#!/bin/sh\necho x\n"}, mode=0o755)
    assert say(machine, "/bin2/x") == "x\n"


def test_a_folder_is_replaced_whole(machine: DockerMachine, tests: Path) -> None:
    """Nothing that the agent has put there before stays."""
    say(machine, "mkdir -p /tests/deep && echo evil > /tests/conftest.py && echo evil > /tests/deep/conftest.py")
    machine.put({"/tests": tests})
    assert sorted(machine.get("/tests")) == ["deep/data", "run.sh"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "trap",
    [
        "ln -s /etc /tests",
        "echo file > /tests",
        "mkfifo /tests",
        "ln -s /tests /tests",
        "mkdir -p /tests/run.sh/folder",
    ],
)
@pytest.mark.few(2)
def test_what_the_agent_has_put_in_the_place_of_a_folder_is_replaced(
    machine: DockerMachine, tests: Path, trap: str
) -> None:
    """And a link of its not followed."""
    say(machine, f"cp /etc/passwd /before && {trap}")
    machine.put({"/tests": tests})
    assert machine.get("/tests") == {"run.sh": b"echo run\n", "deep/data": b"\0\xff"}
    say(machine, "cmp /etc/passwd /before && ! test -e /etc/run.sh && ! test -e /etc/data")


@pytest.mark.thorough
def test_a_file_on_the_way_to_files_is_the_agents_doing(machine: DockerMachine) -> None:
    """They cannot be put there, and the machine is of no use any more."""
    say(machine, "echo file > /logs")
    with pytest.raises(MachineLostError, match="files cannot be put into the machine") as caught:
        machine.put({"/logs/verifier/x": b"x"})
    assert caught.value.by_agent is True


@pytest.mark.few(1)
@pytest.mark.parametrize("here", ["/app", "/opt/other/place"])
def test_saved_files_stand_elsewhere_as_they_were(
    backend: DockerBackend, task: Task, machine: DockerMachine, here: str
) -> None:
    """With owners, permissions and links of both kinds, in place of what was there; a link at the path is followed."""
    look = "cd %s && find . -type d -printf '%%p %%m %%U\\n' -o -printf '%%p %%y %%m %%U %%l %%n\\n' | sort"
    say(
        machine,
        "useradd -m kim; mkdir -p d/e; echo hi > d/e/f; ln d/e/f hard; ln -s greeting soft; ln -s / root; mkfifo fifo;"
        "chown kim d/e/f; chmod 4755 d/e/f; chmod 1777 d; chown kim .; ln -s /app /link; ln -s /none /dead",
    )
    with backend.start(task, SMALL) as other:
        say(other, f"mkdir -p {here} && touch {here}/old")
        for path in ("/app", "/link"):
            archive = BytesIO()
            assert machine.save(path, archive, most_bytes=1_000_000)
            archive.seek(0)
            other.load(here, archive)
            assert say(other, look % here) == say(machine, look % "/app")
        archive = BytesIO()
        assert machine.save("/app/d/e/f", archive, most_bytes=1_000_000)
        archive.seek(0)
        other.load(f"{here}/soft", archive)
        assert other.get(f"{here}/soft") == {"": b"hi\n"}


@pytest.mark.thorough
def test_nothing_is_saved_where_nothing_is_or_too_much(machine: DockerMachine) -> None:
    """What an agent makes too large is its doing."""
    say(machine, "ln -s /none /dead; ln -s /loop /loop; truncate -s 60M big")
    for path in ("/none", "/dead", "/loop", "/app/none/none"):
        assert not machine.save(path, BytesIO(), most_bytes=1000)
    with pytest.raises(MachineLostError, match=r"/app has more than 1 MB to copy") as caught:
        machine.save("/app", BytesIO(), most_bytes=1_000_000)
    assert caught.value.by_agent is True


@pytest.mark.thorough
def test_the_way_to_files_stays_as_it_is(machine: DockerMachine) -> None:
    """A link of the image is followed, as /bin, and a user's folder stays the user's."""
    machine.put({"/bin/tool": b"#!/bin/sh\necho tool\n"}, mode=0o755)
    assert say(machine, "readlink /bin; /usr/bin/tool").splitlines() == ["usr/bin", "tool"]
    assert machine.get("/bin/tool") == {"": b"#!/bin/sh\necho tool\n"}
    say(machine, "mkdir -m 700 /srv/kim && chown nobody /srv/kim")
    machine.put({"/srv/kim/file": b"x"})
    assert say(machine, "stat -c '%a %U' /srv/kim") == "700 nobody\n"


def test_getting_follows_no_links(machine: DockerMachine) -> None:
    """Neither at the path nor below."""
    say(machine, "mkdir -p /logs/real && echo 1 > /logs/real/reward.txt && ln -s /logs/real /logs/verifier")
    assert machine.get("/logs/verifier") == {}
    say(machine, "ln -s /etc/passwd /logs/real/link && mkfifo /logs/real/pipe")
    assert machine.get("/logs/real") == {"reward.txt": b"1\n"}


@pytest.mark.thorough
def test_getting_is_bounded(machine: DockerMachine) -> None:
    """A file without end, as one of holes, is left out; what fits is there."""
    say(machine, "mkdir /out && echo a > /out/a && truncate -s 60M /out/m && echo z > /out/z")
    assert machine.get("/out", most_bytes=1000) in ({"a": b"a\n", "z": b"z\n"}, {"a": b"a\n"}, {"z": b"z\n"}, {})
    assert machine.get("/out/a", most_bytes=2) == {"": b"a\n"}
    assert machine.get("/out/a", most_bytes=1) == {}


def test_removing_follows_no_links(machine: DockerMachine) -> None:
    """What a link leads to stays, and what is not there is no error; a remover that is broken is the agent's doing."""
    say(machine, "mkdir /real && echo 1 > /real/x && ln -s /real /way && mkdir -p /full/deep && touch /full/deep/x")
    machine.remove_files(["/way", "/full", "/none/at/all"])
    assert machine.get("/real") == {"x": b"1\n"}
    assert say(machine, "ls -d /way /full 2>/dev/null; true") == ""
    say(machine, "cp /bin/false /bin/rm; touch /x")
    with pytest.raises(MachineLostError) as caught:
        machine.remove_files(["/x"])
    assert caught.value.by_agent is True
