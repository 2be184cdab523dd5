"""How machines of the backend ``local`` end: with their process, by its death or by theirs, leaving nothing behind."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from local_sandboxes import backend, machine, needs_sandboxes, shell, write_task

from gem_terminal.backends.interface import Limits
from gem_terminal.backends.local import launch, scratch
from gem_terminal.backends.local.backend import LocalBackend
from gem_terminal.errors import EngineError, MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.local.machine import LocalMachine

__all__ = ["backend", "machine"]

# A process that keeps machines busy until it is killed: it starts them in threads, which end, as a pool's do.
OWNER = """
import sys, threading
sys.path[:0] = sys.argv[3:]
from pathlib import Path
from local_sandboxes import write_task
from gem_terminal.backends.interface import Limits
from gem_terminal.backends.local.backend import LocalBackend
folder, count = Path(sys.argv[1]), int(sys.argv[2])
backend = LocalBackend(folder / "scratch")
task = write_task(folder)
machines = []
def start():
    machine = backend.start(task, Limits())
    machine.run(["sh", "-c", "mkdir /app/closed; touch /app/closed/file; chmod 000 /app/closed"], timeout_s=60)
    machine.run(["sh", "-c", f"setsid sleep 98765{folder.name[-4:]} & mkdir /app/deep"], timeout_s=60)
    machine.open_terminal(["sleep", f"98765{folder.name[-4:]}"])
    machine.judge()
    machines.append(machine)
threads = [threading.Thread(target=start) for _ in range(count)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print("ready", flush=True)
sys.stdin.read()
"""


def sleepers(folder: Path) -> list[int]:
    """Return the processes of machines in a folder, wherever they run."""
    marks = [f"98765{folder.name[-4:]}".encode(), *(os.fsencode(path.stem) for path in machines_in(folder))]
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdigit() and any(mark in (entry / "cmdline").read_bytes() for mark in marks):
                found.append(int(entry.name))
    return found


def machines_in(folder: Path) -> list[Path]:
    """Return what is left of machines in a folder."""
    place = folder / "scratch" / "machines"
    return list(place.iterdir()) if place.exists() else []


def own(folder: Path, count: int) -> subprocess.Popen[str]:
    """Start a process that has machines."""
    return subprocess.Popen(
        [sys.executable, "-c", OWNER, str(folder), str(count), *sys.path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def wait_until_gone(folder: Path) -> None:
    """Wait until no process of the machines is left."""
    deadline = time.monotonic() + 60
    while found := sleepers(folder):
        assert time.monotonic() < deadline, found
        time.sleep(0.02)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder whose name ends in digits that no other test's has."""
    needs_sandboxes()
    made = tmp_path / f"{os.getpid()}-{random.randrange(1000, 9999)}"
    made.mkdir()
    return made


def test_machines_end_when_their_process_is_killed(folder: Path) -> None:
    """No process is left at once, and no folder after the next clean-up, what cannot be read included."""
    process = own(folder, 3)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    assert len(sleepers(folder)) >= 3 * 2
    found = LocalBackend(folder / "scratch")
    assert found.clean() == []
    process.kill()
    process.communicate()
    wait_until_gone(folder)
    removed = found.clean()
    assert len([line for line in removed if line.startswith("machine ")]) == 3
    assert machines_in(folder) == []


def test_nothing_is_left_wherever_a_process_is_killed(folder: Path) -> None:
    """At ten moments of its life, that of building and of starting included."""
    moments = random.Random(8)
    for _ in range(10):
        process = own(folder, 2)
        time.sleep(moments.uniform(0.1, 2.0))
        process.kill()
        process.communicate()
        wait_until_gone(folder)
        found = LocalBackend(folder / "scratch")
        found.clean(images=True)
        assert machines_in(folder) == []
        assert [path.name for path in (folder / "scratch" / "templates").iterdir() if path.suffix != ".lock"] == []


def test_machines_end_with_an_interpreter_that_ends_in_order(folder: Path) -> None:
    process = own(folder, 2)
    process.communicate("")
    assert process.returncode == 0
    wait_until_gone(folder)
    assert machines_in(folder) == []


def test_a_machine_whose_first_process_is_killed_is_lost(folder: Path) -> None:
    """And all its processes are, and its folder is removed with it."""
    own_backend = LocalBackend(folder / "scratch")
    machine = own_backend.start(write_task(folder), Limits())
    terminal = machine.open_terminal(["sleep", f"98765{folder.name[-4:]}"])
    assert len(sleepers(folder)) == 3
    for pid in sleepers(folder):
        os.kill(pid, signal.SIGKILL)
    with pytest.raises(MachineLostError, match=r"the machine is gone"):
        machine.run(["sleep", "1000"], timeout_s=60)
    with pytest.raises(MachineLostError, match=r"the machine is gone"):
        terminal.read(30)
    assert machine.why_lost() is not None
    wait_until_gone(folder)
    machine.remove()
    assert machines_in(folder) == []


def test_closing_a_backend_removes_its_machines(backend: LocalBackend, tmp_path: Path) -> None:
    task = write_task(tmp_path)
    machines = [backend.start(task, Limits()) for _ in range(3)]
    backend.close()
    backend.close()
    assert [machine.why_lost() is not None for machine in machines] == [True] * 3


def test_folders_of_any_depth_are_removed(machine: LocalMachine) -> None:
    """The fixture looks whether the machine's folder is gone."""
    deep = "import os\nfor _ in range(3000): os.mkdir('d' * 20); os.chdir('d' * 20)\nos.chmod('.', 0)"
    assert machine.run(["python3", "-c", deep], workdir="/app", timeout_s=60).exit_code == 0
    assert machine.get("/app") == {}
    shell(machine, "chmod 000 /app")


def test_no_start_waits_for_the_removal_of_what_others_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_sandboxes()
    machines = tmp_path / "scratch" / "machines"
    (machines / "dead").mkdir(parents=True)
    (machines / "dead.lock").touch()
    own_scratch, removed, taken = scratch.Scratch(tmp_path / "scratch"), list[Path](), list[scratch.Place]()

    def slow(folder: Path) -> None:
        thread = threading.Thread(target=lambda: taken.append(own_scratch.take()), daemon=True)
        thread.start()
        thread.join(60)
        removed.append(folder)

    with monkeypatch.context() as patch:
        patch.setattr(scratch, "remove", slow)
        assert own_scratch.clean(images=False) == ["machine dead"]
    assert removed == [machines / "dead"]
    assert len(taken) == 1
    own_scratch.give_back(taken[0])


def test_a_machine_that_does_not_start_leaves_nothing_open(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise EngineError("bubblewrap cannot be started")

    own_backend = LocalBackend(folder / "scratch")
    own_backend.build(write_task(folder))
    monkeypatch.setattr(launch, "launch", fail)
    before = os.listdir("/proc/self/fd")
    with pytest.raises(EngineError, match="bubblewrap cannot be started"):
        own_backend.start(write_task(folder), Limits())
    assert os.listdir("/proc/self/fd") == before
    assert machines_in(folder) == []


def test_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    needs_sandboxes()
    (tmp_path / "scratch").mkdir(mode=0o777)
    (tmp_path / "scratch").chmod(0o777)
    with pytest.raises(EngineError, match=r"is not a folder that only this user writes to"):
        LocalBackend(tmp_path / "scratch").clean()


def test_without_bubblewrap_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(EngineError) as caught:
        LocalBackend(tmp_path / "scratch").check(write_task(tmp_path))
    assert str(caught.value) == (
        "bubblewrap is not on the PATH: install bubblewrap ('apt-get install bubblewrap'), or use the backend 'docker'"
    )


def test_a_bubblewrap_that_fails_is_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "bwrap"
    fake.write_text("#!/bin/sh\necho 'bwrap: No permissions to create new namespace' >&2\nexit 1\n", "utf-8")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(EngineError, match=r"new namespace; where user namespaces are forbidden"):
        LocalBackend(tmp_path / "scratch").start(write_task(tmp_path), Limits())


def test_elsewhere_than_on_linux_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(EngineError, match=r"needs Linux, and this is darwin: use the backend 'docker'"):
        LocalBackend(tmp_path / "scratch").check(write_task(tmp_path))
