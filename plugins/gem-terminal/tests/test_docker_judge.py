"""A judge: the same files as the agent left, its servers in reach, and the verifier out of the agent's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, machine, needs_engine, run_label, say, task

from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.docker.machine import DockerMachine
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "machine", "run_label", "task"]
pytestmark = needs_engine

# Run by the agent's root against each process that it can see and that is not its own.
ATTACK = r"""
import os, sys
def place(pid):
    try:
        return os.readlink(f"/proc/{pid}/ns/mnt")
    except OSError:
        return "out of reach"
for pid in filter(str.isdecimal, os.listdir("/proc")):
    if sys.argv[1] == "others" and place(pid) == place("self"):
        continue
    for part in ("environ", "mem", "root/verdict", "cwd/verdict", "fd/0", "maps"):
        path = f"/proc/{pid}/{part}"
        for mode in ("rb", "ab"):
            try:
                with open(path, mode) as file:
                    if part == "environ" and b"SECRET=" in file.read():
                        print("read", path)
                    if "verdict" in part:
                        print("opened", path)
            except OSError as error:
                pass
print("tried", file=sys.stderr)
"""


def test_a_judge_sees_the_files_and_reaches_the_servers(machine: DockerMachine) -> None:
    """What the agent left running goes on, and answers on the loopback."""
    say(machine, "echo mine > /app/work; cd /app; nohup python3 -m http.server 8765 >/dev/null 2>&1 &")
    ask = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:8765/work').read())"
    wait = f'for i in $(seq 100); do python3 -c "{ask}" 2>/dev/null && exit 0; done; exit 1'
    with machine.judge() as judge:
        assert say(judge, "cat work greeting") == "mine\nhello\n"
        assert say(judge, wait) == "b'mine\\n'\n"
        assert "http.server" in say(judge, "cat /proc/[0-9]*/cmdline | tr '\\0' ' '")
        assert judge.processes() == []
        assert [process.command for process in machine.processes()] == ["python3 -m http.server 8765"]
        with pytest.raises(EngineError, match="a judge cannot be judged itself"):
            judge.judge()
    assert [process.command for process in machine.processes()] == ["python3 -m http.server 8765"]


def test_the_agents_root_cannot_look_into_the_verifier(machine: DockerMachine) -> None:
    """Neither its environment nor its memory nor its files, though its processes are in sight."""
    with machine.judge() as judge:
        judge.put({"/verdict": b"0"})
        terminal = judge.open_terminal(["sleep", "2000"], env={"SECRET": "42"})
        done = machine.run(["python3", "-c", ATTACK, "others"], timeout_s=60)
        assert (done.exit_code, done.output) == (0, b"tried\n")
        seen = machine.run(["sh", "-c", "cat /proc/[0-9]*/cmdline | tr '\\0' ' '"], timeout_s=30)
        assert b"sleep 2000" in seen.output
        assert say(judge, "cat /verdict") == "0"
        terminal.close()


def test_the_attack_succeeds_where_nothing_prevents_it(machine: DockerMachine) -> None:
    """Inside one container, as the verifier would be without a judge: so that the test above can fail."""
    machine.put({"/verdict": b"0"})
    terminal = machine.open_terminal(["sleep", "2000"], env={"SECRET": "42"})
    done = machine.run(["python3", "-c", ATTACK, "all"], timeout_s=60)
    assert f"read /proc/{terminal.pid}/environ" in done.output.decode()
    assert "opened /proc/" in done.output.decode()
    terminal.close()


@pytest.mark.thorough
def test_the_agents_root_cannot_become_a_user_and_look_into_that_users_verifier(machine: DockerMachine) -> None:
    """Whoever judges as another user than root has no capability that would keep those of the same user out."""
    become = "import os\nos.setgid(65534); os.setuid(65534)\n"
    with machine.judge(user="nobody") as judge:
        judge.put({"/verdict": b"0"})
        say(judge, "chmod 666 /verdict")
        say(judge, "sleep 2003 > /dev/null 2>&1 &", user="nobody")
        terminal = judge.open_terminal(["sleep", "2000"], user="nobody", env={"SECRET": "42"})
        done = machine.run(["python3", "-c", become + ATTACK, "others"], timeout_s=60)
        assert (done.exit_code, done.output) == (0, b"tried\n")
        assert sorted(process.command for process in judge.processes()) == ["sleep 2000", "sleep 2003"]
        judge.kill(judge.processes())
        assert judge.processes() == []
        terminal.close()


def test_a_judges_root_is_root_whatever_the_list_of_users_says(machine: DockerMachine) -> None:
    say(machine, "sed -i 's/^root:x:0:0/root:x:65534:65534/' /etc/passwd")
    with machine.judge(user="root") as judge:
        assert say(judge, "id -u", user="root") == "0\n"


def test_the_verifiers_files_are_the_judges_alone(machine: DockerMachine) -> None:
    """What is put into a judge is not in the agent's container, and what the agent writes by then not in the judge."""
    with machine.judge() as judge:
        judge.put({"/tests/secret": b"s"})
        say(machine, "echo late > /app/late")
        assert machine.get("/tests") == {}
        assert judge.get("/app/late") == {}


@pytest.mark.thorough
def test_a_late_verifier_is_killed_alone(machine: DockerMachine) -> None:
    """The agent's processes live on."""
    say(machine, "sleep 2001 >/dev/null 2>&1 &")
    with machine.judge() as judge:
        done = judge.run(["sh", "-c", "sleep 2002 & (setsid sleep 2003 &); sleep 2004"], timeout_s=1)
        assert done.exit_code is None
        assert judge.processes() == []
        assert [process.command for process in machine.processes()] == ["sleep 2001"]


def test_a_judge_of_a_machine_that_is_gone_is_an_error_of_the_machine(backend: DockerBackend, task: Task) -> None:
    """Not of the engine."""
    machine = backend.start(task, SMALL)
    machine.remove()
    with pytest.raises(Exception, match="the machine was removed"):
        machine.judge()


def test_a_judge_may_have_no_network_of_the_agents(machine: DockerMachine) -> None:
    """One that is asked for without a network shares that of a machine which has none, and its image goes with it."""
    with machine.judge("none") as judge:
        assert say(judge, "ls /sys/class/net") == "lo\n"
        (image,) = judge.parts.things.images
    assert machine.parts.engine.client.images(name=image) == []
