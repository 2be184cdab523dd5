"""Nothing is left on the engine: not by a close, an end of the interpreter, a fork, or a process that was killed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from typing import TYPE_CHECKING

import pytest
import requests
from docker_machines import BASE, SMALL, backend, left, needs_engine, run_label, soon, task

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.docker.engine import Client
from gem_terminal.backends.docker.sweeping import EXPIRES, OWNER, is_dead, labels, owner, sweep
from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.tasks.task import Task

__all__ = ["backend", "run_label", "task"]
pytestmark = needs_engine

PROGRAM = """
    import os, sys
    from pathlib import Path
    sys.path.insert(0, {tests!r})
    from docker_machines import SMALL, BASE, DockerBackend, make_task, Container
    from gem_terminal.backends.docker.sweeping import labels
    backend = DockerBackend(build_args={{"BASE": BASE}})
    folder = Path({folder!r})
    task = make_task(folder)
    print("begin", flush=True)
    {work}
"""


def program(folder: Path, work: str) -> list[str]:
    """Return a command that does something with a backend in a process of its own."""
    text = textwrap.dedent(PROGRAM).format(tests=os.path.dirname(__file__), folder=str(folder), work=work)
    return [sys.executable, "-c", text]


ENDINGS = [
    "m = backend.start(task, SMALL)",
    "m = backend.start(task, SMALL); raise KeyboardInterrupt",
    # As a start that was broken off may leave.
    "backend.start(task, SMALL); backend.engine.client.create_volume(os.environ['GEM_TERMINAL_RUN'] + 'x', "
    "labels=labels('volume'))",
]


@pytest.mark.parametrize("ending", ENDINGS)
def test_an_interpreter_that_ends_leaves_nothing(task: Task, tmp_path: Path, run_label: str, ending: str) -> None:
    """Nobody has to close anything; also not when an exception ends it."""
    done = subprocess.run(program(tmp_path, ending), capture_output=True, timeout=120, check=False)
    assert b"begin" in done.stdout, done.stderr
    assert left(run_label) == []


def test_a_forked_child_leaves_its_parents_machines_alone(backend: DockerBackend, task: Task) -> None:
    """It can have its own, on connections of its own, and ends without touching its parent's."""
    with backend.start(task, SMALL) as machine:
        child = os.fork()
        if not child:
            code = 1
            try:
                with backend.start(task, SMALL) as own:
                    code = own.run(["sh", "-c", "exit 42"], timeout_s=30).exit_code or 1
                backend.close()
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 42
        assert machine.run(["echo", "here"], timeout_s=30).output == b"here\n"


def test_closing_removes_all_machines(task: Task, run_label: str) -> None:
    """Those that are still held say so afterwards."""
    other = DockerBackend(build_args={"BASE": BASE})
    machines = [other.start(task, SMALL) for _ in range(2)]
    other.close()
    other.close()
    assert left(run_label) == []
    for machine in machines:
        machine.remove()
        with pytest.raises(MachineLostError, match="was removed"):
            machine.run(["true"], timeout_s=5)


SERVICES = "{'db': Container(context=folder, command=('sleep', '99'), volumes={'data': '/data'})}"
WORK = {
    "running": "m = backend.start(task, SMALL)\nwhile True: m.run(['true'], timeout_s=30); m.processes()",
    "serving": f"task = make_task(folder, services={SERVICES})\nwhile True: backend.start(task, SMALL).remove()",
}


@pytest.mark.parametrize("work", WORK)
def test_a_killed_process_is_cleared_up_after(
    backend: DockerBackend, task: Task, tmp_path: Path, run_label: str, work: str
) -> None:
    """Wherever it was killed, the next process to use the engine removes what it has left; others' things stay."""
    backend.start(task, SMALL).remove()
    dice = random.Random(work)
    with backend.start(task, SMALL) as kept:
        for _ in range(3):
            with subprocess.Popen(program(tmp_path, WORK[work]), stdout=subprocess.PIPE) as process:
                assert process.stdout is not None
                assert process.stdout.readline() == b"begin\n"
                # Any moment will do, and no outcome hangs on which one it is.
                time.sleep(dice.uniform(0.05, 1.2))
                process.send_signal(signal.SIGKILL)
        # What it had asked for just before its end may still be under way.
        assert soon(lambda: sweep(backend.engine) is None or len(left(run_label)) == 1)
        assert left(run_label) == [f"container ['/{kept.id}']"]
        assert kept.run(["true"], timeout_s=30).exit_code == 0


def test_an_owner_is_dead_only_where_that_is_sure() -> None:
    """This process is not, another machine's is unknown, and a number that was given anew is no owner."""
    place, pid, started = owner().split(":")
    boot, namespace, user = place.split("/")
    assert is_dead(f"{place}:{pid}:{int(started) + 1}")
    assert is_dead(f"{place}:4194999:1")
    alive = [owner(), f"elsewhere/1:{pid}:1", f"{boot}/{namespace}/{int(user) + 1}:4194999:1"]
    alive += ["", ":", "::", "a:b", f"{place}:x:1", f"{place}:-1:1"]
    assert [text for text in alive if is_dead(text)] == []


def test_what_has_expired_is_removed_whoever_owns_it(backend: DockerBackend, run_label: str) -> None:
    """As after a machine of which this one knows nothing; what has not expired stays."""
    marks = labels("volume") | {OWNER: "elsewhere/1/0:1:1"}
    client = backend.engine.client
    client.create_volume(f"{run_label}-old", labels=marks | {EXPIRES: "1000000000"})
    client.create_volume(f"{run_label}-new", labels=marks)
    assert f"volume volume {run_label}-old" in sweep(backend.engine)
    assert left(run_label) == [f"volume {run_label}-new"]
    client.remove_volume(f"{run_label}-new")


def test_what_could_not_be_removed_is_removed_at_the_end(
    backend: DockerBackend, task: Task, run_label: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when the engine was busy for a while."""

    def hang(*_: object, **__: object) -> None:
        raise requests.ReadTimeout("timed out")

    with monkeypatch.context() as patch, backend.start(task, SMALL):
        patch.setattr(Client, "remove_container", hang)
    assert [line.split()[0] for line in left(run_label)] == ["container"]
    backend.close()
    assert left(run_label) == []
