"""Attacks on what lies around the sandbox: the network, other processes, the kernel.

Each is really tried; afterwards the pool still serves, and no process, file or memory is left.
"""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from python_levels import SHORT, SMALL, Watched, attack, each_level, gained, processes, until

from gem_tools.python import Limits, Outcome

watched = each_level()


@pytest.fixture
def listening() -> Iterator[int]:
    """A server on this machine's loopback."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_network(watched: Watched, listening: int) -> None:
    """There is none, by name or by address; not even this machine's loopback, nor its abstract sockets."""
    name = f"\0gem-{secrets.token_hex(4)}"
    kinds = [
        f"socket.socket({family}, socket.{kind})" for family in NETWORKS for kind in ("SOCK_STREAM", "SOCK_SEQPACKET")
    ]
    with socket.socket(socket.AF_UNIX) as abstract:
        abstract.bind(name)
        abstract.listen()
        assert (
            gained(
                watched,
                f"socket.create_connection(('127.0.0.1', {listening}), 1)",
                "socket.create_connection(('1.1.1.1', 53), 1)",
                "socket.create_connection(('2606:4700:4700::1111', 53), 1)",
                f"socket.create_connection(('localhost', {listening}), 1)",
                "socket.create_connection(('example.org', 80), 1)",
                "socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'x', ('1.1.1.1', 53))",
                "socket.socket(socket.AF_INET, socket.SOCK_RAW, 1)",
                "socket.socket(socket.AF_PACKET, socket.SOCK_RAW)",
                f"socket.socket(socket.AF_UNIX).connect({name!r})",
                *kinds,
            )
            == []
        )


NETWORKS = (socket.AF_VSOCK.value, socket.AF_ALG.value, socket.AF_CAN.value, 45)


# Other processes.


@pytest.mark.root
def test_killing_siblings_and_parents(watched: Watched) -> None:
    """No signal reaches any process but its own."""
    bystander = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    pids = ["os.getppid()", os.getpid(), bystander.pid, *range(2, 40)]
    try:
        lines = [f"kill({pid}, {number})" for pid in pids for number in (9, 15, 19, 0)]
        assert gained(watched, *lines, *(f"os.killpg({group}, 9)" for group in (os.getpgid(0), 2, 3))) == []
        assert bystander.poll() is None
    finally:
        bystander.kill()
        bystander.wait()


@pytest.mark.thorough
@pytest.mark.parametrize("target", [0, -1])
def test_killing_everything(watched: Watched, target: int) -> None:
    """Its own group, and all that it may signal: at most itself."""
    attack(watched, f"import os, signal\nos.kill({target}, signal.SIGKILL)")
    attack(watched, f"import os, signal\nos.kill({target}, signal.SIGSTOP)", Limits(wall_s=1))


@pytest.mark.few(1)
@pytest.mark.root
def test_daemons_that_fork_without_an_end(watched: Watched) -> None:
    """Each new process has lost its parent before it can be found: none is left when the call, or a session, rests."""
    code = """
import os
for _ in range(3):
    if os.fork() == 0:
        os.setsid()
        while True:
            if os.fork(): os._exit(0)
print("left some")
"""
    for _ in range(5):
        assert attack(watched, code).stdout == "left some\n"
    session = watched.pool.session(SMALL)
    try:
        assert session.run(f"x = 1\n{code}").stdout == "left some\n"
        assert session.run("x").value == "1"
    finally:
        session.close()
    watched.check()


@pytest.mark.root
def test_daemons_whose_first_thread_has_ended(watched: Watched) -> None:
    """They look like zombies, and live."""
    code = """
import ctypes, os, threading, time
for _ in range(3):
    if os.fork() == 0:
        os.setsid()
        threading.Thread(target=time.sleep, args=(300,)).start()
        ctypes.CDLL(None).pthread_exit(None)
time.sleep(0.05)
print("left some")
"""
    assert attack(watched, code).stdout == "left some\n"
    session = watched.pool.session(SMALL)
    try:
        assert session.run(code).stdout == "left some\n"
        assert until(lambda: len(processes(watched.pool)) == watched.count + 1)
    finally:
        session.close()
    watched.check()


def test_sockets_of_one_session_are_out_of_reach_of_others(watched: Watched) -> None:
    """Abstract names and ports are each session's own, or are not to be had at all."""
    names = '((socket.AF_UNIX, "\\0name"), (socket.AF_INET, ("127.0.0.1", 8000)), (socket.AF_INET6, ("::1", 8000)))'
    listen = f"""
import socket
kept = []
for family, name in {names}:
    try:
        server = socket.socket(family)
        server.bind(name)
        server.listen()
        socket.socket(family).connect(name)
        kept.append(server)
    except OSError: pass
len(kept)
"""
    reach = f"""
import socket
reached = []
for family, name in {names}:
    try:
        socket.socket(family).connect(name)
        reached.append(name)
    except OSError: pass
reached
"""
    first, second = watched.pool.session(SMALL), watched.pool.session(SMALL)
    try:
        kept = first.run(listen).value
        assert kept in (("2", "3") if watched.pool.level == "bubblewrap" else ("0",))
        assert second.run(reach).value == "[]"
        assert second.run(listen).value == kept
        assert watched.pool.run(reach, value=True).value == "[]"
    finally:
        first.close()
        second.close()
    watched.check()


def test_rare_system_calls(watched: Watched) -> None:
    """Tracing, namespaces, mounts, keys, bpf, rings, messages and other users are refused."""
    assert (
        gained(
            watched,
            "call(libc.ptrace(16, os.getppid(), 0, 0))",
            "call(libc.unshare(0x10000000))",
            "call(libc.unshare(0x00020000))",
            "call(libc.mount(b'none', b'/tmp', b'tmpfs', 0, None))",
            "call(libc.umount2(b'/tmp', 2))",
            "call(libc.chroot(b'/tmp'))",
            "call(libc.setns(0, 0))",
            "call(libc.syscall(250 if x86 else 219, 0, -3, 1))",
            "call(libc.syscall(321 if x86 else 280, 0, 0, 0))",
            "call(libc.syscall(425, 1, buffer))",
            "call(libc.syscall(435, buffer, 88))",
            "call(libc.syscall(298 if x86 else 241, buffer, 0, -1, -1, 0))",
            "call(libc.syscall(310 if x86 else 270, os.getppid(), 0, 0, 0, 0, 0))",
            "call(libc.syscall(56 if x86 else 220, 0x10000011, 0, 0, 0, 0))",
            "call(libc.setuid(0))",
            "call(libc.setgid(0))",
            "call(libc.sethostname(b'x', 1))",
            "call(libc.mq_open(b'/x', 0o102, 0o600, None))",
            "call(libc.semget(0, 1, 0o1600))",
            "call(libc.msgget(0, 0o1600))",
        )
        == []
    )


@pytest.mark.thorough
def test_capabilities_are_gone(watched: Watched) -> None:
    """A process has none, and cannot get any by starting a program that would give them."""
    code = """
import ctypes
class Header(ctypes.Structure): _fields_ = [("version", ctypes.c_uint32), ("pid", ctypes.c_int)]
data = (ctypes.c_uint32 * 6)()
libc = ctypes.CDLL(None)
libc.capget(ctypes.byref(Header(0x20080522, 0)), data)
print(list(data[:2]), libc.prctl(39, 0, 0, 0, 0))
"""
    assert attack(watched, code).stdout == "[0, 0] 1\n"


@pytest.mark.thorough
def test_attacks_at_once(watched: Watched) -> None:
    """Calls that wait behind an attack are served after it."""
    outcomes: list[Outcome] = []
    bomb = "import os\nwhile True:\n    try: os.fork()\n    except OSError: pass"
    codes = [bomb, "print(1)", "kept = bytearray(1 << 40)", "print(2)"]
    threads = [
        threading.Thread(target=lambda code=code: outcomes.append(watched.pool.run(code, limits=SHORT)))
        for code in codes
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcome.stdout for outcome in outcomes) == ["", "", "1\n", "2\n"]
    watched.check()
