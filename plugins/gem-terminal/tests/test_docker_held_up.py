"""Agents that stop or kill whatever the engine starts in their container, which must hold up nobody."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, needs_engine, run_label, task

from gem_terminal.backends.docker import terminal
from gem_terminal.backends.docker.warden import frozen
from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.docker.machine import DockerMachine
    from gem_terminal.tasks.task import Task

__all__ = ["backend", "run_label", "task"]  # fixtures; the one of the run finds what is left behind

pytestmark = needs_engine

# It returns once what comes up is stopped, which it sees without a program of its own.
_STOP_ALL = r"""cat > /stop.sh <<'END'
while :; do for p in /proc/[0-9]*; do p=${p#/proc/}; [ "$p" -gt $$ ] && kill -STOP "$p"; done; done
END
setsid bash /stop.sh < /dev/null > /dev/null 2>&1 &
sleep 1000 > /dev/null 2>&1 &
while read -r -d '' status < /proc/$!/status; [[ $status != *"T (stopped)"* ]]; do :; done"""


def stop_all(machine: DockerMachine) -> None:
    """Leave something running that stops whatever comes up."""
    assert machine.run(["bash", "-c", _STOP_ALL], timeout_s=60.0).exit_code == 0


def test_program_that_never_starts_ends_the_machine_by_its_agents_fault(
    backend: DockerBackend, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine's own process is stopped in the container, before it turns into the program."""
    machine = backend.start(task, SMALL)
    stop_all(machine)
    monkeypatch.setattr(terminal, "START_S", 5.0)
    with pytest.raises(MachineLostError, match="no program starts in the machine any more") as caught:
        machine.run(["true"], timeout_s=60)
    assert caught.value.by_agent
    lost = machine.why_lost()
    assert lost is not None
    assert lost.by_agent
    machine.remove()


def test_terminal_that_never_starts_ends_the_machine_by_its_agents_fault(
    backend: DockerBackend, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    with backend.start(task, SMALL) as machine:
        stop_all(machine)
        monkeypatch.setattr(terminal, "START_S", 5.0)
        with pytest.raises(MachineLostError, match="no program starts") as caught:
            machine.open_terminal(["bash"])
        assert caught.value.by_agent


def test_judge_and_its_programs_start_though_whatever_comes_up_is_stopped(backend: DockerBackend, task: Task) -> None:
    """What the agent left is frozen in the moments in which something starts beside it."""
    with backend.start(task, SMALL) as machine:
        stop_all(machine)
        with machine.judge() as judge:
            for _ in range(3):
                assert judge.run(["true"], timeout_s=5.0).exit_code in (0, None)  # it may be stopped afterwards
            assert judge.why_lost() is None
        assert [one for one in machine.processes() if "stop.sh" in one.command]


def test_machine_whose_start_hangs_says_what_it_wrote_and_is_removed(
    backend: DockerBackend, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watch over the disk asks in a thread of its own, at any time."""
    with backend.start(task, SMALL) as machine:
        stop_all(machine)
        client = machine.parts.engine.client
        wish = terminal.Wish(["true"])
        exec_id = terminal.execute(client, machine.id, wish, tty=False, size=(0, 0))
        stream = terminal.begin(client, exec_id, tty=False)
        assert stream.read(1.0) == b""
        assert machine.why_lost() is None
        assert (machine.written_mb() or 0) < 1
        machine.remove()
        stream.close()


def test_fork_bomb_may_go_on_as_before_it_was_frozen(backend: DockerBackend, task: Task) -> None:
    """Where the kernel gives up, as on a busy machine, its limit is changed for a moment, and then as it was."""
    bomb = "import os\nwhile True:\n try: os.fork()\n except OSError: pass"
    with backend.start(task, SMALL) as machine:
        assert machine.run(["sh", "-c", 'python3 -c "$0" > /dev/null 2>&1 &', bomb], timeout_s=60.0).exit_code == 0
        inspect = machine.parts.engine.client.inspect_container
        for _ in range(5):
            with frozen(machine.parts.engine, machine.id):
                pass  # it may be frozen by now; a kernel that could not is no error
            about = inspect(machine.id)
            assert (about["State"]["Status"], about["HostConfig"]["PidsLimit"]) == ("running", SMALL.processes)
