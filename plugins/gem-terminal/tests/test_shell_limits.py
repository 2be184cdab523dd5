"""The end of a command's time: what it started is killed, what was there before goes on, and the shell is usable."""
# ruff: noqa: F811 - the fixtures come from shell_machines

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
from shell_machines import backend, has_bash, machine, shell  # noqa: F401 - fixtures

from gem_terminal.backends.interface import Process
from gem_terminal.shell.shell import started_by_command

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine
    from gem_terminal.shell import Shell

LONG = 30.0
SHORT = 0.5
LATE = [
    "sleep 4321",
    "cat",
    "python3 -q",
    "while :; do :; done",
    "stty raw -isig; cat",
    "sh -c 'trap \"\" INT TERM HUP; sleep 4321; sleep 4321'",
    "cat /dev/urandom",
    "kill -STOP $$",
]


def commands(machine: Machine, part: str) -> set[tuple[int, str]]:
    """Return what runs in a machine and has a word in its command."""
    return {(process.pid, process.command) for process in machine.processes() if part in process.command}


def earlier(machine: Machine, part: str, count: int) -> set[tuple[int, str]]:
    """Wait until so many jobs have become what they are to be, in an earlier tick of the clock than what comes."""
    for _ in range(1000):
        jobs = [process for process in machine.processes() if process.command.startswith(part)]
        now = time.clock_gettime(time.CLOCK_BOOTTIME) * 100
        if len(jobs) == count and now > max(job.started for job in jobs) + 2:
            return commands(machine, part)
    raise AssertionError(f"no {count} jobs {part!r}")


@pytest.mark.parametrize("command", LATE)
def test_run_kills_what_takes_too_long(machine: Machine, shell: Shell, command: str) -> None:
    """The command is ended, says so, and the next one is answered; mostly by the same shell."""
    shell.run("x=here", LONG)
    result = shell.run(f"echo before; {command}", SHORT)
    assert (result.exit_code, result.timed_out) == (None, True)
    assert result.output.startswith("before\n")
    assert result.note.startswith("The command ran longer than 0.5 s and was killed")
    assert not commands(machine, "4321") | commands(machine, "urandom")
    kept = "" if result.restarted else "here"
    assert shell.run('echo "${x-}"', LONG).output == f"{kept}\n"
    assert result.restarted == (command == "kill -STOP $$")


def test_run_kills_what_hides(machine: Machine, shell: Shell) -> None:
    """Daemons, new sessions, background jobs and what ignores signals are killed; an earlier job goes on."""
    shell.run("sleep 7001 >/dev/null 2>&1 & sleep 7002 & : ; (setsid sleep 7003 >/dev/null 2>&1 &)", LONG)
    before = earlier(machine, "sleep 700", 3)
    hiding = (
        "sleep 8001 & nohup sleep 8002 >/dev/null 2>&1 & (setsid sh -c \"trap '' TERM HUP INT; sleep 8003; :\" &) ; "
        "setsid sh -c '(sleep 8004 &) ; sleep 8005' & python3 -c \"import os,time;"
        'os.fork() and os._exit(0); os.setsid(); os.fork() and os._exit(0); time.sleep(8006)"; cat'
    )
    assert shell.run(hiding, 2.0).timed_out
    assert not commands(machine, "800")
    assert commands(machine, "sleep 700") == before
    assert shell.run("echo here", LONG).output.endswith("here\n")


def test_run_spares_what_an_earlier_job_starts(machine: Machine, shell: Shell) -> None:
    """A server that was started before may start what it likes while a command runs out of time."""
    shell.run("(until test -e go; do sleep 0.02; done; sleep 7101) >/dev/null 2>&1 &", LONG)
    assert shell.run("touch go; cat", 1.0).timed_out
    assert commands(machine, "7101")


def test_run_kills_a_fork_bomb(machine: Machine, shell: Shell) -> None:
    """Processes that start one another, bounded by their depth as the limits of a host are everyone's, all end."""
    bomb = "b() { if [ $1 -gt 0 ]; then b $(($1 - 1)) & b $(($1 - 1)) & fi; sleep 9001; }; b 5; cat"
    assert shell.run(bomb, 1.0).timed_out
    assert not commands(machine, "9001")
    assert shell.run("echo here", LONG).output.endswith("here\n")


def test_run_replaces_a_shell_that_does_not_listen(machine: Machine, shell: Shell) -> None:
    """A shell that spins and ignores interrupts is replaced, in the directory that it had gone to."""
    shell.run("sleep 7201 >/dev/null 2>&1 &", LONG)
    before = earlier(machine, "sleep 7201", 1)
    result = shell.run("mkdir sub; cd sub; trap '' INT; while :; do :; done", SHORT)
    assert (result.timed_out, result.restarted) == (True, True)
    assert "a new one was started" in result.note
    assert shell.run('basename "$PWD"', LONG).output == "sub\n"
    assert commands(machine, "7201") == before


def process(pid: int, parent: int, started: int) -> Process:
    """Return a process; its session and command do not matter."""
    return Process(pid, parent, started, "x", 1)


def test_started_by_command_goes_by_age_and_line() -> None:
    """Young processes of the shell and young orphans are the command's; what older ones started is not."""
    there = [
        process(1, 0, 100),
        process(10, 0, 900),  # leader
        process(11, 10, 901),  # shell
        process(20, 11, 950),  # an earlier job
        process(21, 20, 2000),  # started by it now
        process(30, 11, 1500),
        process(31, 30, 1501),
        process(32, 1, 1502),  # a daemon
        process(33, 999, 1502),  # its parent has just ended
        process(40, 0, 1600),  # put there from outside
        process(41, 40, 1601),
        process(50, 11, 1500),  # the last job, of the same moment
    ]
    found = started_by_command(there, 15.0, {10, 11}, background=50)
    assert [each.pid for each in found] == [30, 31, 32, 33]
