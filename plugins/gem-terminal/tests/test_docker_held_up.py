"""An agent that stops whatever the engine starts in its container, which must hold up nobody."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import SMALL, backend, needs_engine, run_label, task

from gem_terminal.backends.docker import running
from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.backend import DockerBackend
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


def test_program_that_never_starts_ends_the_machine_by_its_agents_fault(
    backend: DockerBackend, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine's own process is stopped in the container, before it turns into the program."""
    with backend.start(task, SMALL) as machine:
        assert machine.run(["bash", "-c", _STOP_ALL], timeout_s=60.0).exit_code == 0
        monkeypatch.setattr(running, "START_S", 5.0)
        with pytest.raises(MachineLostError, match="no program starts in the machine any more") as caught:
            machine.run(["true"], timeout_s=60)
        assert caught.value.by_agent
        lost = machine.why_lost()
        assert lost is not None
        assert lost.by_agent
