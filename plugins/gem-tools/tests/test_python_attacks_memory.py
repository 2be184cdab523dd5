"""Memory that no process seems to hold, or that many hold together: it counts, and counts once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from python_levels import ALL, Watched, attack, pool_of

from gem_tools.python import Limits

LIMITS = Limits(wall_s=20, cpu_s=60, memory_mb=96, processes=16, folder_mb=64, file_mb=64)

TOUCH = """
import mmap, os, sys, time
def touched(size):
    memory = mmap.mmap(-1, size)
    for place in range(0, size, 4096): memory[place] = 1
    return memory
def wait(): sys.stdout.flush(); time.sleep(60)
"""


@pytest.fixture(scope="module", params=[*ALL, "own user"])
def watched(request: pytest.FixtureRequest) -> Iterator[Watched]:
    """A pool of each level, and of one whose code runs as this user, also where that is root."""
    from gem_tools.python import levels

    with pytest.MonkeyPatch.context() as patch:
        if request.param == "own user":
            patch.setattr(levels, "_spare_uid", lambda count: None)
        pool = pool_of("process" if request.param == "own user" else request.param)
        yield Watched(pool)
        pool.close()


@pytest.mark.few(1)
@pytest.mark.root
def test_shared_memory_of_many_processes(watched: Watched) -> None:
    """Twelve with 24 MB each are 288, not 24."""
    code = f"{TOUCH}\nfor _ in range(12):\n    if os.fork() == 0: kept = touched(24 << 20); wait()\nwait()"
    outcome = attack(watched, code, LIMITS)
    assert (outcome.status, outcome.error) == ("memory", "The limit of 96 MB of memory was reached.")


@pytest.mark.thorough
def test_processes_whose_first_thread_has_ended_count(watched: Watched) -> None:
    """The kernel shows the memory of such a process by its other threads alone."""
    code = f"""{TOUCH}
import ctypes, threading
for _ in range(4):
    if os.fork() == 0:
        def take():
            time.sleep(0.1)
            kept = touched(40 << 20)
            wait()
        threading.Thread(target=take).start()
        ctypes.CDLL(None).pthread_exit(None)
time.sleep(60)
"""
    assert attack(watched, code, LIMITS).status == "memory"


@pytest.mark.thorough
@pytest.mark.parametrize(
    "code",
    [
        "kept = touched(60 << 20)",
        "kept = b'x' * (60 << 20)",
        "kept = touched(40 << 20); more = bytearray(b'x') * (20 << 20)",
    ],
    ids=["mapped", "private", "both"],
)
def test_what_processes_share_counts_once(watched: Watched, code: str) -> None:
    """Six that have the same 60 MB use 60."""
    children = """
for _ in range(5):
    if os.fork() == 0:
        seen = sum(kept[place] for place in range(0, len(kept), 4096))
        time.sleep(0.5)
        os._exit(0)
for _ in range(5): os.wait()
"""
    outcome = attack(watched, f"{TOUCH}\n{code}\n{children}", LIMITS)
    assert outcome.status == "ok", outcome


@pytest.mark.thorough
def test_a_session_holds_what_it_took_in_earlier_calls(watched: Watched) -> None:
    """And others that rest in the same sandbox do not count."""
    sessions = [watched.pool.session(LIMITS) for _ in range(3)]
    take = f"{TOUCH}\nkept = [touched(30 << 20)]"
    try:
        assert [session.run(take).status for session in sessions] == ["ok"] * 3
        assert sessions[0].run("kept.append(touched(30 << 20))\ntime.sleep(0.1)").status == "ok"
        more = "if os.fork() == 0:\n    kept.clear()\n    kept = touched(50 << 20)\n    wait()\nwait()"
        assert sessions[0].run(more).status == "memory"
        assert sessions[1].run("len(kept[0])\n").value == str(30 << 20)
    finally:
        for session in sessions:
            session.close()
    watched.check()


@pytest.mark.thorough
def test_files_in_memory_count(watched: Watched) -> None:
    """Those that are mapped by nobody, and those that have no name any more."""
    if watched.pool.level == "process":
        pytest.skip("the folder is on disk")
    code = f"""{TOUCH}
kept = touched(70 << 20)
files = [open(str(number), "wb") for number in range(2)]
os.unlink("1")
for stream in files: stream.write(bytes(29 << 20)); stream.flush()
wait()
"""
    assert attack(watched, code, LIMITS).status == "memory"


@pytest.mark.thorough
def test_buffers_of_sockets_count(watched: Watched) -> None:
    """The kernel holds them for the call."""
    code = """
import os, socket, time
for _ in range(8):
    if os.fork() == 0: break
kept = []
for _ in range(60):
    for end in socket.socketpair():
        kept.append(end)
        end.setblocking(False)
        try:
            while True: end.send(bytes(1 << 16))
        except BlockingIOError: pass
time.sleep(60)
"""
    assert attack(watched, code, LIMITS).status == "memory"


def test_buffers_of_connections_count(watched: Watched) -> None:
    """A session may have a loopback of its own; what waits there to be read is the kernel's memory too."""
    if watched.pool.level != "bubblewrap":
        pytest.skip("there are no connections")
    session = watched.pool.session(LIMITS)
    code = """
import os, socket, time
for _ in range(8):
    if os.fork() == 0: break
kept = []
server = socket.create_server(("127.0.0.1", 0))
for _ in range(50):
    kept += [socket.create_connection(server.getsockname()), server.accept()[0]]
    for end in kept[-2:]:
        end.setblocking(False)
        try:
            while True: end.send(bytes(1 << 16))
        except BlockingIOError: pass
time.sleep(5)
"""
    try:
        assert session.run(code).status == "memory"
    finally:
        session.close()
    watched.check()
