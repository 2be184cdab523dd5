"""Attacks on the Python sandbox that take all there is: processes, memory, time, output.

Each is really tried; afterwards the pool still serves, and no process, file or memory is left.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path

import pytest
from python_levels import SHORT, SMALL, Watched, attack, each_level, pool_of

from gem_tools.python import Limits

watched = each_level()

CPU = Limits(wall_s=60, cpu_s=0.4)
WALL = Limits(wall_s=0.5, cpu_s=60)
OVER = ("error", "memory", "cpu", "timeout")
IGNORE = """
import signal
for number in range(1, 65):
    try: signal.signal(number, signal.SIG_IGN)
    except (OSError, ValueError): pass
signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 65))
while True: pass
"""
MEMFD = "import os\nfor number in range(100):\n    m = os.memfd_create('x')\n    os.write(m, bytes(8 << 20))"
SHARED = "import ctypes\nlibc = ctypes.CDLL(None, use_errno=True)\nassert libc.shmget(0, 1 << 20, 0o1600) >= 0"


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("code", "limits", "ends"),
    [
        ("while True: pass", WALL, ("timeout",)),
        ("import os\nos.fork()\nos.fork()\nwhile True: pass", CPU, ("cpu",)),
        (IGNORE, WALL, ("timeout",)),
        ("import os\nwhile True:\n    try: os.fork()\n    except OSError: pass", SHORT, ("timeout", "cpu")),
        ("import os\nos.fork()\nwhile True: os.write(2, b'\\xff\\x00' * 5000)", SMALL, ("output",)),
        ("import mmap\nkept = [mmap.mmap(-1, 1 << 20) for _ in range(1000)]", SHORT, OVER),
        (MEMFD, SHORT, OVER),
        (SHARED, SHORT, OVER),
        ("x = 'a' * (1 << 40)", SHORT, OVER),
        ("[0] * (1 << 33)", SHORT, OVER),
        ("9 ** 9 ** 9", SHORT, OVER),
        ("x = []\nx.append(x)\ny = [x] * 10 ** 9", SHORT, OVER),
    ],
)
def test_what_has_no_end_is_ended(watched: Watched, code: str, limits: Limits, ends: tuple[str, ...]) -> None:
    """Loops, processes, output and memory, in each way that there is; the limit is told, and kept."""
    outcome = attack(watched, code, limits)
    assert outcome.status in ends
    if limits is WALL:
        assert (outcome.error, outcome.wall_s >= 0.5) == ("The time limit of 0.5 s was reached.", True)
    if limits is CPU:
        assert outcome.error == "The limit of 0.4 s of processor time was reached."


@pytest.mark.root
def test_processes_are_counted(watched: Watched) -> None:
    """No more at once than the limit says, the first included; exactly so many where they have a user to themselves."""
    code = """
import os, sys, time
made = 0
try:
    while made < 100:
        if os.fork() == 0:
            time.sleep(60)
        made += 1
except BlockingIOError:
    print(made)
    sys.stdout.flush()
    os._exit(0)
"""
    outcome = attack(watched, code)
    assert outcome.status == "ok"
    if watched.pool.level == "process" and os.geteuid() != 0:
        # Counted together with the user's other processes, of which some may end meanwhile, as those of other tests do.
        assert int(outcome.stdout) < 100
    else:
        assert outcome.stdout == "15\n"


@pytest.mark.thorough
def test_threads_count_as_processes(watched: Watched) -> None:
    """As the kernel counts them; each takes address space as well, of which there is enough here."""
    code = """
import threading, time, os
made = 0
try:
    while made < 100:
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
        made += 1
except RuntimeError:
    print(made, flush=True)
    os._exit(0)
"""
    assert attack(watched, code, dataclasses.replace(SMALL, memory_mb=1024)).stdout == "15\n"


def test_memory_bomb(watched: Watched) -> None:
    """One process cannot take more than the limit."""
    outcome = attack(watched, "kept = []\nwhile True:\n    kept.append(bytearray(1 << 20))")
    assert outcome.status == "memory"
    assert outcome.error == "MemoryError"
    assert outcome.peak_mb < 140


@pytest.mark.few(2)
@pytest.mark.root
@pytest.mark.parametrize("place", ["folder", "shared", "unlinked"])
def test_files_in_the_memory_of_the_machine_count(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """In shared memory, and in a folder in memory, as ``/tmp`` is on many systems."""
    if not os.access("/dev/shm", os.W_OK) or "/dev/shm tmpfs" not in Path("/proc/mounts").read_text("utf-8"):
        pytest.skip("there is no shared memory")
    if place == "shared" and os.geteuid() != 0:
        pytest.skip("only root's calls may use shared memory")
    monkeypatch.setattr(tempfile, "tempdir", "/dev/shm")
    watched = Watched(pool_of("process"))
    try:
        where = "/dev/shm/gem-" if place == "shared" else ""
        code = f"""
import os, time
for number in range(12):
    if os.fork() == 0:
        with open(f"{where}{{number}}", "wb") as stream:
            if {place == "unlinked"}: os.unlink(stream.name)
            stream.write(bytes(24 << 20))
            stream.flush()
            time.sleep(60)
time.sleep(60)
"""
        # Limits of the folder and of processes are out of the way: the kernel counts the processes of the whole user,
        # those of other tests included, and whichever limit is noticed first would decide.
        limits = dataclasses.replace(SMALL, memory_mb=96, file_mb=64, folder_mb=1024, processes=2000)
        assert attack(watched, code, limits).status == "memory"
    finally:
        watched.pool.close()


def test_endless_output(watched: Watched) -> None:
    """It is cut, and what is kept has the exact length."""
    outcome = attack(watched, "while True:\n    print('x' * 1000)")
    assert outcome.status == "output"
    kept = outcome.stdout.replace(f"\n[… {outcome.dropped[0]} bytes left out …]\n", "")
    assert len(kept) == 2000
    assert outcome.dropped_bytes < 10_000_000


@pytest.mark.thorough
def test_raising_its_own_limits(watched: Watched) -> None:
    """Hard limits cannot be raised."""
    code = """
import resource
for name in ("AS", "NPROC", "CPU", "FSIZE", "NOFILE", "CORE"):
    number = getattr(resource, f"RLIMIT_{name}")
    soft, hard = resource.getrlimit(number)
    assert hard != resource.RLIM_INFINITY, name
    try:
        resource.setrlimit(number, (hard + 1, hard + 1))
    except ValueError:
        print(name)
"""
    assert attack(watched, code).stdout.split() == ["AS", "NPROC", "CPU", "FSIZE", "NOFILE", "CORE"]


@pytest.mark.thorough
def test_open_files_and_file_size(watched: Watched) -> None:
    """Both have their limits, exact ones."""
    code = """
import os
try:
    with open("big", "wb") as stream:
        for _ in range(9):
            stream.write(bytes(1 << 20))
            stream.flush()
except OSError as error:
    print(error.errno, os.path.getsize("big"))
files = []
try:
    while True:
        files.append(os.open(os.devnull, os.O_RDONLY))
except OSError as error:
    print(error.errno, max(files))
"""
    assert attack(watched, code).stdout == f"27 {8 << 20}\n24 127\n"
