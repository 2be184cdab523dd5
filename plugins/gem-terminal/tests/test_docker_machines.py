"""What runs in a machine of a real engine: commands, terminals, processes, limits, and how a machine is lost."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, machine, make_task, needs_engine, run_label, say, task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import MachineLostError
from gem_terminal.shell import Shell
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.docker.machine import DockerMachine
    from gem_terminal.backends.docker.running import DockerTerminal
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "machine", "run_label", "task"]
pytestmark = needs_engine


def until(terminal: DockerTerminal, text: bytes, *, within_s: float = 30.0) -> bytes:
    """Read until a text has come."""
    heard = b""
    deadline = time.monotonic() + within_s
    while text not in heard and time.monotonic() < deadline:
        heard += terminal.read(1.0)
    assert text in heard, heard
    return heard


def commands(machine: DockerMachine) -> list[str]:
    return sorted(process.command for process in machine.processes())


def test_a_command_gives_output_in_order_and_its_exit_code(machine: DockerMachine) -> None:
    """In the image's folder, with the variables that were given; or as another user and elsewhere."""
    script = "echo one; echo two >&2; echo $WORD; pwd; exit 3"
    done = machine.run(["sh", "-c", script], env={"WORD": "x y"}, timeout_s=30)
    assert (done.exit_code, done.output, done.dropped) == (3, b"one\ntwo\nx y\n/app\n", 0)
    done = machine.run(["sh", "-c", "id -un; pwd"], user="nobody", workdir="/tmp", timeout_s=30)
    assert done.output == b"nobody\n/tmp\n"


def test_a_command_that_cannot_run_or_is_killed_has_the_shells_exit_code(machine: DockerMachine) -> None:
    """As a shell would say it; what the engine says of an unknown user or folder is the output."""
    for words, code, said in (
        (["no-such-program"], 127, "not found"),
        (["/etc/passwd"], 126, "Permission denied"),
        (["sh", "-c", "kill -9 $$"], 137, ""),
        (["sh", "-c", "kill -TERM $$"], 143, ""),
    ):
        done = machine.run(words, timeout_s=30)
        assert (done.exit_code, said in done.output.decode()) == (code, True)
    done = machine.run(["true"], user="ghost", timeout_s=30)
    assert (done.exit_code, b"ghost" in done.output) == (126, True)
    done = machine.run(["true"], workdir="/nowhere", timeout_s=30)
    assert done.exit_code not in (0, None)
    assert b"/nowhere" in done.output
    assert machine.why_lost() is None


def test_long_output_is_cut_in_the_middle(machine: DockerMachine) -> None:
    """Half of what is kept is from the beginning, half from the end, and the rest is counted."""
    done = machine.run(["sh", "-c", "seq 1 100000"], timeout_s=60, most_output=100)
    whole = "".join(f"{number}\n" for number in range(1, 100001)).encode()
    assert done.output == whole[:50] + whole[-50:]
    assert done.dropped == len(whole) - 100


def test_what_goes_on_in_the_background_is_not_waited_for(machine: DockerMachine) -> None:
    """Though it holds the command's output open."""
    done = machine.run(["sh", "-c", "sleep 1000 & echo done"], timeout_s=60)
    assert (done.exit_code, done.output) == (0, b"done\n")
    assert commands(machine) == ["sleep 1000"]


def soon(machine: DockerMachine, wanted: list[str]) -> bool:
    """Whether just that runs in a machine: a process that was killed may take a moment to end under load."""
    deadline = time.monotonic() + 30
    while commands(machine) != wanted and time.monotonic() < deadline:
        pass
    return commands(machine) == wanted


def test_a_late_command_is_killed_with_all_that_came_up_below_it(machine: DockerMachine) -> None:
    """Also what left its session and its parent; what was there before lives on."""
    say(machine, "setsid sleep 1001 >/dev/null 2>&1 &")
    script = "echo here; (setsid sh -c 'sleep 1002; sleep 1003' &); sleep 1004 & trap '' TERM HUP; sleep 1005"
    done = machine.run(["sh", "-c", script], timeout_s=2)
    assert (done.exit_code, done.output) == (None, b"here\n")
    assert soon(machine, ["sleep 1001"])


def test_a_fork_bomb_is_ended_by_its_time_limit(machine: DockerMachine) -> None:
    """Nothing gets away from the kill, however fast it multiplies, and the machine is of use afterwards."""
    bomb = "import os\nwhile True:\n try: os.fork()\n except OSError: pass"
    done = machine.run(["python3", "-c", bomb], timeout_s=3)
    assert done.exit_code is None
    assert soon(machine, [])
    assert say(machine, "echo fine") == "fine\n"


def test_processes_are_seen_whatever_their_names(machine: DockerMachine) -> None:
    """Names may hold any byte."""
    name = "import ctypes, time; ctypes.CDLL(None).prctl(15, b'a) S 1\\n2 (b', 0, 0, 0); time.sleep(1000)"
    machine.run(["sh", "-c", f'python3 -c "{name}" >/dev/null 2>&1 & true'], timeout_s=30)
    found = machine.processes()
    assert [process.command.split()[0] for process in found] == ["python3"]
    machine.kill(found)
    assert machine.processes() == []


def test_a_process_whose_number_is_anothers_by_now_is_not_killed(machine: DockerMachine) -> None:
    """A process is named by its number and the time of its start."""
    say(machine, "sleep 1008 >/dev/null 2>&1 &")
    (found,) = machine.processes()
    other = type(found)(found.pid, found.parent, found.started - 1, found.command, found.session)
    machine.kill([other])
    assert machine.processes() == [found]


def test_a_terminal_is_a_terminal_of_the_size_asked_for(machine: DockerMachine) -> None:
    """With the container's environment, the variables given, and the number of the program."""
    terminal = machine.open_terminal(["sh"], env={"WORD": "word"}, workdir="/tmp", columns=91, lines=33)
    terminal.write(b"stty size; tty; echo $WORD-$(pwd)-$$-\n")
    heard = until(terminal, f"word-/tmp-{terminal.pid}-\r\n".encode())
    assert b"33 91\r\n/dev/pts/" in heard
    terminal.close()
    terminal.close()


def test_reading_a_terminal_ends_with_its_time_or_its_program(machine: DockerMachine) -> None:
    """Nothing to read is no error; the end of the program is one, and the agent's."""
    terminal = machine.open_terminal(["sh"])
    until(terminal, b"# ")
    assert terminal.read(0.05) == b""
    assert terminal.read(0.0) == b""
    terminal.write(b"exit\n")
    with pytest.raises(MachineLostError, match="the program in the terminal has ended") as caught:
        until(terminal, b"never")
    assert caught.value.by_agent is True
    terminal.close()


def test_a_closed_terminal_hangs_up(machine: DockerMachine) -> None:
    """Its program and the jobs of that are gone then."""
    terminal = machine.open_terminal(["bash", "-i"])
    terminal.write(b"sleep 1009\n")
    until(terminal, b"sleep 1009")
    terminal.close()
    deadline = time.monotonic() + 30
    while machine.processes() and time.monotonic() < deadline:
        pass
    assert machine.processes() == []


def test_typing_that_nobody_reads_is_dropped_in_time(machine: DockerMachine) -> None:
    """A program that does not read its terminal blocks nobody for long."""
    terminal = machine.open_terminal(["sleep", "1010"])
    terminal.write(b"x" * 20_000_000)
    assert machine.why_lost() is None
    terminal.close()


def test_a_program_that_is_not_there_opens_no_terminal(machine: DockerMachine) -> None:
    """The error is at once, and names it as the machine's."""
    with pytest.raises(MachineLostError, match="the program could not be started"):
        machine.open_terminal(["no-such-shell"])


def test_root_can_do_what_it_has_to_and_little_else(machine: DockerMachine) -> None:
    """Owners, users, and becoming one of them; no device, no mount, and nothing but the loopback."""
    assert say(machine, "useradd -m kim && su kim -c 'id -un; touch ~/x' && chown nobody ~kim/x") == "kim\n"
    assert say(machine, "dpkg --audit; echo $?") == "0\n"
    assert machine.run(["mknod", "/tmp/disk", "b", "8", "0"], timeout_s=30).exit_code != 0
    assert machine.run(["mount", "-t", "tmpfs", "none", "/mnt"], timeout_s=30).exit_code != 0
    assert say(machine, "ls /sys/class/net") == "lo\n"
    assert say(machine, "cat /proc/net/route").count("\n") == 1


def test_memory_processes_and_files_are_limited(machine: DockerMachine) -> None:
    """A program that takes too much fails by itself, and the machine stays."""
    assert machine.run(["python3", "-c", "x = b'x' * (400 << 20)"], timeout_s=60).exit_code == 137
    assert machine.run(["dd", "if=/dev/zero", "of=/big", "bs=1M", "count=80"], timeout_s=60).exit_code != 0
    assert machine.why_lost() is None
    start = "threading.Thread(target=time.sleep, args=(5,), daemon=True).start()"
    threads = f"import threading, time\nfor _ in range(100): {start}"
    assert machine.run(["python3", "-c", threads], timeout_s=60).exit_code == 1


def test_a_new_shell_starts_beside_as_many_processes_as_there_may_be(machine: DockerMachine) -> None:
    """An honest agent with too many jobs goes on."""
    shell = Shell(machine)
    more = "while True: subprocess.Popen(['sleep', '1013'])"
    shell.run(f'python3 -c "import subprocess\n{more}" 2>/dev/null; kill -9 $$', 60)
    assert shell.run("ls -d /usr", 60).output == "/usr\n"
    shell.close()


def test_writing_more_than_allowed_ends_the_machine(backend: DockerBackend, task: Task) -> None:
    """It is the agent's doing, and is said so from then on."""
    with backend.start(task, Limits(storage_mb=20, memory_mb=512)) as machine:
        say(machine, "for i in 1 2 3 4; do dd if=/dev/zero of=/big$i bs=1M count=15 2>/dev/null || true; done")
        with pytest.raises(MachineLostError, match=r"wrote \d+ MB, more than its 20") as caught:
            machine.run(["sleep", "300"], timeout_s=300)
        assert caught.value.by_agent is True
        with pytest.raises(MachineLostError, match="more than its 20"):
            machine.run(["true"], timeout_s=30)


def test_a_machine_survives_an_agent_that_kills_all_it_can(machine: DockerMachine) -> None:
    """As ``docker run … sleep infinity`` would; and orphans are taken care of, whatever was killed."""
    machine.run(["sh", "-c", "kill -9 -1"], timeout_s=30)
    say(machine, "(sleep 0.1 &) ; pkill sleep || true")
    assert machine.why_lost() is None
    deadline = time.monotonic() + 30
    while (states := say(machine, "cat /proc/[0-9]*/stat")).count(") Z ") and time.monotonic() < deadline:
        pass
    assert ") Z " not in states
    assert commands(machine) == []


def test_a_machine_whose_first_process_ends_is_lost_by_the_agent(backend: DockerBackend, tmp_path: Path) -> None:
    """As where it is a program of the task's that the agent has ended."""
    main = Container(context=tmp_path, command=("sleep", "1012"))
    with backend.start(make_task(tmp_path, main=main), SMALL) as machine:
        machine.run(["sh", "-c", "kill -9 -1"], timeout_s=30)
        deadline = time.monotonic() + 30
        while machine.why_lost() is None and time.monotonic() < deadline:
            pass
        with pytest.raises(
            MachineLostError, match=r"first process was ended \(exit code \d+; it began as 'sleep 1012'\)"
        ) as caught:
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


def test_commands_of_several_threads_do_not_disturb_one_another(machine: DockerMachine) -> None:
    """One that is killed for its time takes none of the others with it."""
    started = threading.Event()

    def late() -> int | None:
        started.set()
        return machine.run(["sh", "-c", "sleep 1011"], timeout_s=1).exit_code

    def steady(number: int) -> bytes:
        started.wait(30)
        return machine.run(["sh", "-c", f"sleep 3; echo {number}"], timeout_s=60).output

    with ThreadPoolExecutor(4) as pool:
        killed = pool.submit(late)
        outputs = list(pool.map(steady, range(3)))
    assert killed.result() is None
    assert outputs == [b"0\n", b"1\n", b"2\n"]
