"""Files into and out of a machine, with an agent that has put links and worse where they belong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import backend, machine, needs_engine, run_label, say, task

from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.machine import DockerMachine

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


@pytest.mark.parametrize(
    "trap",
    [
        "ln -s /etc /tests",
        "mkdir /tests && ln -s /etc /tests/deep",
        "mkdir -p /tests/deep && ln -s /etc/passwd /tests/deep/data",
        "mkdir /tests && ln -s /etc/passwd /tests/run.sh",
        "echo file > /tests",
        "mkfifo /tests",
        "ln -s /tests /tests",
        "mkdir -p /tests/run.sh/folder",
    ],
)
@pytest.mark.few(2)
def test_links_of_the_agents_are_replaced_and_not_followed(machine: DockerMachine, tests: Path, trap: str) -> None:
    """Whether the whole folder is put or a file on a path through them."""
    say(machine, f"cp /etc/passwd /before && {trap}")
    machine.put({"/tests/run.sh": tests / "run.sh", "/tests/deep/data": b"data"})
    assert machine.get("/tests/run.sh") == {"": b"echo run\n"}
    assert machine.get("/tests/deep/data") == {"": b"data"}
    machine.put({"/tests": tests})
    assert machine.get("/tests") == {"run.sh": b"echo run\n", "deep/data": b"\0\xff"}
    say(machine, "cmp /etc/passwd /before && ! test -e /etc/run.sh && ! test -e /etc/data")


def test_links_of_the_image_are_followed(machine: DockerMachine) -> None:
    """As /bin, which leads to /usr/bin and has to stay."""
    machine.put({"/bin/tool": b"#!/bin/sh\necho tool\n"}, mode=0o755)
    assert say(machine, "readlink /bin; /usr/bin/tool").splitlines() == ["usr/bin", "tool"]
    assert machine.get("/bin/tool") == {"": b"#!/bin/sh\necho tool\n"}


def test_owners_of_folders_on_the_way_stay(machine: DockerMachine) -> None:
    """A file is put into a user's folder without taking that away."""
    say(machine, "mkdir -m 700 /srv/kim && chown nobody /srv/kim")
    machine.put({"/srv/kim/file": b"x"})
    assert say(machine, "stat -c '%a %U' /srv/kim") == "700 nobody\n"


def test_getting_follows_no_links(machine: DockerMachine) -> None:
    """Neither at the path, nor on the way, nor below."""
    say(machine, "mkdir -p /logs/real && echo 1 > /logs/real/reward.txt && ln -s /logs/real /logs/verifier")
    assert machine.get("/logs/verifier") == {}
    assert machine.get("/logs/verifier/reward.txt") == {}
    say(machine, "ln -s /etc/passwd /logs/real/link && mkfifo /logs/real/pipe")
    assert machine.get("/logs/real") == {"reward.txt": b"1\n"}


def test_getting_is_bounded(machine: DockerMachine) -> None:
    """A file without end, as one of holes, is left out; what fits is there."""
    say(machine, "mkdir /out && echo a > /out/a && truncate -s 60M /out/m && echo z > /out/z")
    assert machine.get("/out", most_bytes=1000) in ({"a": b"a\n", "z": b"z\n"}, {"a": b"a\n"}, {"z": b"z\n"}, {})
    assert machine.get("/out/a", most_bytes=2) == {"": b"a\n"}
    assert machine.get("/out/a", most_bytes=1) == {}


def test_removing_follows_no_links(machine: DockerMachine) -> None:
    """A link is removed and what it leads to stays; what is not there is no error."""
    say(machine, "mkdir /real && echo 1 > /real/x && ln -s /real /way && mkdir -p /full/deep && touch /full/deep/x")
    machine.remove_files(["/way/x", "/full", "/none/at/all"])
    assert machine.get("/real") == {"x": b"1\n"}
    assert say(machine, "ls -d /way /full 2>/dev/null; true") == ""


def test_a_remover_that_was_tampered_with_is_found_out(machine: DockerMachine) -> None:
    """Files that stay are the agent's doing."""
    say(machine, "cp /bin/true /bin/rm; mkdir /logs; touch /logs/reward.txt")
    with pytest.raises(MachineLostError, match=r"/logs/reward\.txt cannot be removed") as caught:
        machine.remove_files(["/logs/reward.txt"])
    assert caught.value.by_agent is True


@pytest.mark.parametrize("path", ["relative", "/", "", "//", "/a/../.."])
def test_paths_that_name_no_file_are_refused(machine: DockerMachine, path: str) -> None:
    """The root, or none that is absolute."""
    with pytest.raises(Exception, match="is no absolute path of a file or folder"):
        machine.put({path: b"x"})
