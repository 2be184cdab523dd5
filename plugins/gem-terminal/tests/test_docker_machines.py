"""What runs in a machine of a real engine: commands, terminals, processes, limits, and how a machine is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, machine, make_task, needs_engine, run_label, say, soon, task

from gem_terminal.backends.docker import running
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import MachineLostError
from gem_terminal.shell import Shell
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.docker.machine import DockerMachine
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "machine", "run_label", "task"]
pytestmark = needs_engine


def commands(machine: DockerMachine) -> list[str]:
    return sorted(process.command for process in machine.processes())


def test_a_command_gives_output_in_order_and_its_exit_code(machine: DockerMachine) -> None:
    """In the image's folder, with the variables given; or as another user and elsewhere; cut in the middle."""
    script = "echo one; echo two >&2; echo $WORD; pwd; exit 3"
    done = machine.run(["sh", "-c", script], env={"WORD": "x y"}, timeout_s=30)
    assert (done.exit_code, done.output, done.dropped) == (3, b"one\ntwo\nx y\n/app\n", 0)
    done = machine.run(["sh", "-c", "id -un; pwd"], user="nobody", workdir="/tmp", timeout_s=30)
    assert done.output == b"nobody\n/tmp\n"
    done = machine.run(["sh", "-c", "seq 1 100000"], timeout_s=60, most_output=100)
    whole = "".join(f"{number}\n" for number in range(1, 100001)).encode()
    assert (done.output, done.dropped) == (whole[:50] + whole[-50:], len(whole) - 100)


def test_a_command_that_cannot_run_or_is_killed_has_the_shells_exit_code(machine: DockerMachine) -> None:
    """As a shell would say it; what the engine says of an unknown user or folder is the output."""
    for words, how, codes, said in (
        (["no-such-program"], {}, [127], b"not found"),
        (["/etc/passwd"], {}, [126], b"Permission denied"),
        (["sh", "-c", "kill -TERM $$"], {}, [143], b""),
        (["true"], {"user": "ghost"}, [126], b"ghost"),
        (["true"], {"workdir": "/nowhere"}, range(1, 128), b"/nowhere"),
    ):
        done = machine.run(words, timeout_s=30, **how)
        assert (done.exit_code in codes, said in done.output) == (True, True), done
    assert machine.why_lost() is None


def test_a_late_command_is_killed_with_all_that_came_up_below_it(machine: DockerMachine) -> None:
    """Also what left its session and its parent; what was there before lives on, and is not waited for."""
    done = machine.run(["sh", "-c", "sleep 1000 & echo done"], timeout_s=60)
    assert (done.exit_code, done.output) == (0, b"done\n")
    script = "echo here; (setsid sh -c 'sleep 1002; sleep 1003' &); sleep 1004 & trap '' TERM HUP; sleep 1005"
    done = machine.run(["sh", "-c", script], timeout_s=2)
    assert (done.exit_code, done.output) == (None, b"here\n")
    assert soon(lambda: commands(machine) == ["sleep 1000"])


def test_a_fork_bomb_is_ended_by_its_time_limit(machine: DockerMachine) -> None:
    """Nothing gets away from the kill, however fast it multiplies, and the machine is of use afterwards."""
    bomb = "import os\nwhile True:\n try: os.fork()\n except OSError: pass"
    assert machine.run(["python3", "-c", bomb], timeout_s=3).exit_code is None
    assert soon(lambda: commands(machine) == [])
    assert say(machine, "echo fine") == "fine\n"


def test_processes_are_known_by_number_and_start_whatever_their_names(machine: DockerMachine) -> None:
    """Names may hold any byte; one whose number is another's by now is not killed."""
    name = "import ctypes, time; ctypes.CDLL(None).prctl(15, b'a) S 1\\n2 (b', 0, 0, 0); time.sleep(1000)"
    machine.run(["sh", "-c", f'python3 -c "{name}" >/dev/null 2>&1 & true'], timeout_s=30)
    (found,) = machine.processes()
    assert found.command.split()[0] == "python3"
    machine.kill([type(found)(found.pid, found.parent, found.started - 1, found.command, found.session)])
    assert machine.processes() == [found]
    machine.kill([found])
    assert machine.processes() == []


def test_a_terminal_is_a_terminal_of_the_size_asked_for(machine: DockerMachine) -> None:
    """With the variables given and the number of the program; its end is the agent's, and closing it hangs up."""
    terminal = machine.open_terminal(["sh"], env={"WORD": "word"}, workdir="/tmp", columns=91, lines=33)
    terminal.write(b"stty size; tty; echo $WORD-$(pwd)-$$-\n")
    heard: list[bytes] = []
    last = f"word-/tmp-{terminal.pid}-\r\n".encode()
    assert soon(lambda: last in b"".join(heard) or heard.append(terminal.read(1.0)))
    assert b"33 91\r\n/dev/pts/" in b"".join(heard)
    assert terminal.read(0.0) == b""
    terminal.write(b"exit\n")
    with pytest.raises(MachineLostError, match="ended") as caught:
        soon(lambda: terminal.read(1.0) is None)
    assert caught.value.by_agent is True
    terminal.close()
    terminal = machine.open_terminal(["bash", "-c", "sleep 1009"])
    terminal.write(b"x" * 20_000_000)  # is dropped in time, as nobody reads it
    terminal.close()
    terminal.close()
    assert soon(lambda: machine.processes() == [])
    with pytest.raises(MachineLostError, match="could not be started"):
        machine.open_terminal(["no-such-shell"])


def test_root_can_do_what_it_has_to_and_little_else(machine: DockerMachine) -> None:
    """Owners, users, and becoming one of them; no device, no mount, and nothing but the loopback."""
    assert say(machine, "useradd -m kim && su kim -c 'id -un; touch ~/x' && chown nobody ~kim/x") == "kim\n"
    assert say(machine, "dpkg --audit; echo $?") == "0\n"
    assert machine.run(["mknod", "/tmp/disk", "b", "8", "0"], timeout_s=30).exit_code != 0
    assert machine.run(["mount", "-t", "tmpfs", "none", "/mnt"], timeout_s=30).exit_code != 0
    assert say(machine, "ls /sys/class/net") == "lo\n"


def test_memory_processes_and_files_are_limited(machine: DockerMachine) -> None:
    """A program that takes too much fails by itself, and the machine stays."""
    assert machine.run(["python3", "-c", "x = b'x' * (400 << 20)"], timeout_s=60).exit_code == 137
    assert machine.run(["dd", "if=/dev/zero", "of=/big", "bs=1M", "count=80"], timeout_s=60).exit_code != 0
    start = "threading.Thread(target=time.sleep, args=(5,), daemon=True).start()"
    threads = f"import threading, time\nfor _ in range(100): {start}"
    assert machine.run(["python3", "-c", threads], timeout_s=60).exit_code == 1
    shell = Shell(machine)  # starts beside as many processes as there may be
    more = "while True: subprocess.Popen(['sleep', '1013'])"
    shell.run(f'python3 -c "import subprocess\n{more}" 2>/dev/null; kill -9 $$', 60)
    assert shell.run("ls -d /usr", 60).output == "/usr\n"
    shell.close()
    assert machine.why_lost() is None


def test_writing_more_than_allowed_ends_the_machine(backend: DockerBackend, task: Task) -> None:
    """It is the agent's doing, and is said so from then on."""
    with backend.start(task, Limits(storage_mb=20, memory_mb=512)) as machine:
        say(machine, "for i in 1 2 3 4; do dd if=/dev/zero of=/big$i bs=1M count=15 2>/dev/null || true; done")
        for command in ("300", "0"):
            with pytest.raises(MachineLostError, match="more than its 20") as caught:
                machine.run(["sleep", command], timeout_s=300)
            assert caught.value.by_agent is True


def test_a_machine_survives_an_agent_that_kills_all_it_can(machine: DockerMachine) -> None:
    """As ``docker run … sleep infinity`` would; and orphans are taken care of, whatever was killed."""
    machine.run(["sh", "-c", "kill -9 -1"], timeout_s=30)
    say(machine, "(sleep 0.1 &) ; pkill sleep || true")
    assert machine.why_lost() is None
    assert soon(lambda: ") Z " not in say(machine, "cat /proc/[0-9]*/stat"))
    assert commands(machine) == []


def test_a_machine_whose_first_process_ends_is_lost_by_the_agent(backend: DockerBackend, tmp_path: Path) -> None:
    """As where it is a program of the task's that the agent has ended."""
    main = Container(context=tmp_path, command=("sleep", "1012"))
    with backend.start(make_task(tmp_path, main=main), SMALL) as machine:
        machine.run(["sh", "-c", "kill -9 -1"], timeout_s=30)
        assert soon(machine.why_lost)
        with pytest.raises(MachineLostError, match=r"exit code \d+; it began as 'sleep 1012'") as caught:
            machine.run(["true"], timeout_s=30)
        assert caught.value.by_agent is True
        with pytest.raises(MachineLostError):
            machine.open_terminal(["sh"])


def test_a_machine_that_others_ended_or_removed_is_lost_by_nobody_here(backend: DockerBackend, task: Task) -> None:
    """The engine was told to, by whoever."""
    with backend.start(task, SMALL) as machine:
        backend.engine.client.kill(machine.id)
        lost = machine.why_lost()
        assert lost is not None
        assert lost.by_agent is False
        backend.engine.client.remove_container(machine.id, force=True)
        with pytest.raises(MachineLostError, match="removed by someone else") as caught:
            machine.put({"/x": b""})
        assert caught.value.by_agent is False


# It returns once what comes up is stopped, which it sees without a program of its own.
STOP_ALL = r"""cat > /stop.sh <<'END'
while :; do for p in /proc/[0-9]*; do p=${p#/proc/}; [ "$p" -gt $$ ] && kill -STOP "$p"; done; done
END
setsid bash /stop.sh < /dev/null > /dev/null 2>&1 &
sleep 1000 > /dev/null 2>&1 &
while read -r -d '' status < /proc/$!/status; [[ $status != *"T (stopped)"* ]]; do :; done"""


def test_program_that_never_starts_ends_the_machine_by_its_agents_fault(
    machine: DockerMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine's own process is stopped in the container, before it turns into the program."""
    assert machine.run(["bash", "-c", STOP_ALL], timeout_s=60.0).exit_code == 0
    monkeypatch.setattr(running, "START_S", 5.0)
    with pytest.raises(MachineLostError) as caught:
        machine.run(["true"], timeout_s=60)
    lost = machine.why_lost()
    assert (caught.value.by_agent, lost and lost.by_agent) == (True, True)
