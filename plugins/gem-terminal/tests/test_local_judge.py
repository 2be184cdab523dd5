"""Judging in the backend ``local``: what the agent left running is there, and can reach nothing of the verifier's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from local_sandboxes import backend, left_running, machine, shell, wait_for, write_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.local.backend import LocalBackend
    from gem_terminal.backends.local.machine import LocalMachine

__all__ = ["backend", "machine"]

# Tries for ever to write and to read what is a verifier's, by every way through /proc that root has.
ATTACK = """
import os, pathlib
parts = "environ mem maps smaps io auxv syscall stack fd/0 fd/1 ns/mnt ns/pid exe root/tests cwd/tests".split()
def reach(process, part):
    path = f"{process}/{part}"
    for way in (os.readlink, os.listdir, lambda path: open(path, "rb").read(1), lambda path: open(path, "ab")):
        try:
            way(path)
        except OSError:
            continue
        with open("/app/reached", "a") as file: file.write(f"{path}\\n")
while True:
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes()
        except OSError:
            continue
        if words == b"python3\\0/tests/verifier.py\\0":
            for part in parts: reach(process, part)
            pathlib.Path("/app/tried").write_text("tried")
    pathlib.Path("/logs/verifier/reward.txt").write_text("1")
    pathlib.Path("/tests/verifier.py").write_text("forged")
"""
VERIFIER = b"""
import os, time
assert open("/tests/verifier.py").read().startswith("\\nimport os")
assert not os.path.exists("/logs/verifier/reward.txt")
time.sleep(3)
open("/logs/verifier/reward.txt", "w").write("0")
time.sleep(1)
"""


def test_an_agent_cannot_reach_a_verifiers_files_environment_or_memory(machine: LocalMachine) -> None:
    machine.put({"/app/attack.py": ATTACK.encode()})
    shell(machine, "mkdir -p /tests /logs/verifier; setsid python3 /app/attack.py &")
    wait_for(machine, "test -s /tests/verifier.py")
    with machine.judge() as judge:
        judge.put({"/tests/verifier.py": VERIFIER})
        judge.remove_files(["/logs/verifier"])
        shell(judge, "mkdir -p /logs/verifier")
        done = judge.run(["python3", "/tests/verifier.py"], env={"SECRET": "1"}, timeout_s=60)
        assert (done.exit_code, done.output) == (0, b"")
        assert judge.get("/logs/verifier") == {"reward.txt": b"0"}
    assert machine.get("/app/reached") == {}
    assert machine.get("/app/tried") != {}


def test_a_judge_sees_and_reaches_what_the_agent_left_running(machine: LocalMachine) -> None:
    shell(machine, "cd /app; echo served > page; python3 -m http.server 8123 >/dev/null 2>&1 & sleep 1000 &")
    fetch = "import urllib.request as r; print(r.urlopen('http://localhost:8123/page').read().decode(), end='')"
    wait_for(machine, f'python3 -c "{fetch}" 2>/dev/null')
    with machine.judge() as judge:
        assert shell(judge, f'python3 -c "{fetch}"; cat /app/page') == "served\nserved\n"
        assert shell(judge, "pgrep -fx 'sleep 1000' | wc -l") == "1\n"


def test_a_judge_has_a_copy_of_the_files(machine: LocalMachine) -> None:
    """Contents, permissions, links and times are the agent's; what changes later in one does not in the other."""
    shell(machine, "cd /app; echo old > file; chmod 640 file; ln -s file link; ln file hard; touch -d 2001-01-01 file")
    with machine.judge() as judge:
        shell(machine, "echo new > /app/file")
        shell(judge, "rm /app/link")
        assert shell(judge, "cat /app/file; stat -c '%a %h %y' /app/file") == (
            "old\n640 2 2001-01-01 00:00:00.000000000 +0000\n"
        )
        assert shell(machine, "readlink /app/link; cat /app/file") == "file\nnew\n"


def test_the_processes_of_a_machine_and_of_its_judge_are_told_apart(machine: LocalMachine) -> None:
    left_running(machine, 1001)
    with machine.judge() as judge:
        left_running(judge, 1002)
        assert [process.command for process in machine.processes()] == ["sleep 1001"]
        assert [process.command for process in judge.processes()] == ["sleep 1002"]
    assert [process.command for process in machine.processes()] == ["sleep 1001"]
    assert shell(machine, "pgrep -fx 'sleep 1002' || echo none") == "none\n"


def test_a_judge_ends_with_its_machine(machine: LocalMachine) -> None:
    judge = machine.judge()
    machine.remove()
    with pytest.raises(MachineLostError):
        judge.run(["true"], timeout_s=10)
    judge.remove()


@pytest.mark.thorough
def test_a_judge_runs_though_the_agent_has_taken_all_processes(backend: LocalBackend, tmp_path: Path) -> None:
    with backend.start(write_task(tmp_path), Limits(processes=30)) as machine:
        machine.run(["bash", "-c", "while :; do sleep 1000 & done"], timeout_s=1.0)
        machine.run(["bash", "-c", "for n in {1..100}; do sleep 1000 & done"], timeout_s=60)
        with machine.judge() as judge:
            assert shell(judge, "for n in 1 2 3 4 5; do sleep 0.01 & done; wait; echo judged") == "judged\n"


def test_a_judge_is_prepared_before_anything_runs_in_it(machine: LocalMachine) -> None:
    shell(machine, "echo forged > /etc/profile; echo more > /app/mine; rm /etc/passwd; chmod 777 /srv")
    seen: list[object] = []

    def prepare(judge: LocalMachine) -> None:
        seen.append(judge.changed())
        seen.append(judge.put_back(["/etc/passwd", "/etc/profile", "/srv", "/etc/hosts", "/app/mine", "/usr/bin/env"]))

    with machine.judge(prepare=prepare) as judge:
        assert "root:x:0" in shell(judge, "cat /etc/passwd; stat -c %a /srv; test ! -e /app/mine")
        assert judge.changed() == {}
    assert seen == [
        {"/etc/profile": "changed", "/app/mine": "added", "/etc/passwd": "removed", "/srv": "changed"},
        ["/etc/passwd", "/etc/profile", "/srv", "/app/mine"],
    ]


def test_a_judge_whose_preparation_fails_is_not_left_behind(machine: LocalMachine) -> None:
    def fail(judge: LocalMachine) -> None:
        left_running(judge, 1000)
        raise EngineError("not prepared")

    with pytest.raises(EngineError, match="not prepared"):
        machine.judge(prepare=fail)
    assert shell(machine, "pgrep -fx 'sleep 1000' || echo none") == "none\n"


def test_what_changed_is_told_though_its_times_are_forged(machine: LocalMachine) -> None:
    shell(
        machine,
        "cp -a /etc/hosts /tmp/hosts; tr l L < /tmp/hosts > /etc/hosts; touch -r /tmp/hosts /etc/hosts; rm /tmp/hosts;"
        "rm -r /media; ln -s / /media; mkdir -p /new/inner; touch /new/inner/file; touch /etc/group",
    )
    assert machine.changed() == {
        "/etc/hosts": "changed",
        "/media": "changed",
        "/new": "added",
        "/new/inner": "added",
        "/new/inner/file": "added",
    }


def test_put_back_replaces_links_on_the_way_and_brings_folders_back_whole(machine: LocalMachine) -> None:
    shell(machine, "cp -a /etc /app/kept; rm -rf /etc; ln -s /app/mine /etc; mkdir /app/mine; rm -rf /usr/local/bin")
    assert machine.put_back(["/etc/passwd", "/usr/local/bin"]) == ["/etc/passwd", "/usr/local/bin"]
    assert machine.get("/app/mine") == {}
    assert machine.put_back(["/etc"]) == []
    assert sorted(machine.get("/etc")) == ["passwd"]
    machine.remove_files(["/etc"])
    assert machine.put_back(["/etc"]) == ["/etc"]
    assert shell(machine, "diff -r /etc /app/kept; ls /usr/local/bin | wc -l").splitlines()[-1] >= "1"


def test_a_judge_with_a_network_is_refused(machine: LocalMachine) -> None:
    with pytest.raises(TaskError, match=r"the network 'public', which a sandbox lacks: use 'docker'"):
        machine.judge("public")


def test_a_judge_that_is_dismissed_meanwhile_takes_no_machine_with_it(machine: LocalMachine) -> None:
    """As when the end of an episode comes while its verifier runs in another thread."""
    judge = machine.judge()
    judge._release()
    with pytest.raises(EngineError, match=r"there is no view 'judges/1' \(any more\)"):
        judge.processes()
    assert shell(machine, "echo there") == "there\n"
