"""Attacks by code that runs as the very user who started it, as on the level ``process`` without root.

Everything that belongs to this user is tried: variables, files, processes, sockets.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from python_levels import SMALL, Watched, attack, gained, pool_of

from gem_tools.python import Limits, levels


@pytest.fixture(scope="module")
def watched() -> Iterator[Watched]:
    """A pool whose code runs as this user, also where this user is root."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(levels, "_spare_uid", lambda count: None)
        patch.setenv("GEM_SECRET", "in the environment")
        pool = pool_of("process")
        if not pool.cells[0].ready["walled"]:
            pool.close()
            pytest.skip("this kernel has no Landlock")
        yield Watched(pool)
        pool.close()


@pytest.fixture
def bystander() -> Iterator[subprocess.Popen[bytes]]:
    """A process of the same user, with a secret in its environment."""
    environment = {"BYSTANDER": "secret"}
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], env=environment)
    yield process
    process.kill()
    process.wait()


def test_it_is_the_same_user(watched: Watched) -> None:
    """Or the other tests would try nothing."""
    assert attack(watched, "import os\nprint(os.getuid())").stdout == f"{os.getuid()}\n"


def test_looking_into_other_processes(watched: Watched, bystander: subprocess.Popen[bytes]) -> None:
    """Neither this process nor another shows its variables, memory, files or arguments."""
    lines = []
    for pid in (str(os.getpid()), "{os.getppid()}", str(bystander.pid)):
        files = ("environ", "mem", "maps", "cmdline", "status", "auxv")
        lines += [f"open(f'/proc/{pid}/{name}', 'rb').read(16)" for name in files]
        lines += [f"os.readlink(f'/proc/{pid}/{name}')" for name in ("cwd", "root", "exe", "fd/0")]
    assert gained(watched, *lines) == []


def test_reading_and_writing_files_of_its_user(watched: Watched, tmp_path: Path) -> None:
    """Only the system, the interpreter and its own folder can be opened."""
    private = tmp_path / "private"
    private.write_text("kept", "utf-8")
    private.chmod(0o600)
    places = [str(tmp_path), tempfile.gettempdir(), "/tmp", "/var/tmp", "/dev/shm", "/run/lock"]
    name, path = secrets.token_hex(8), str(private)
    lines = [f"open({path!r}).read()", f"os.truncate({path!r}, 0)", f"os.unlink({path!r})"]
    lines += [f"os.link({path!r}, 'linked')", f"os.rename({path!r}, 'moved')", "os.open('/dev/ptmx', os.O_RDWR)"]
    for place in (*places, os.path.expanduser("~")):
        lines += [f"os.listdir({place!r})", f"open('{place}/{name}', 'w')", f"os.mkdir('{place}/{name}')"]
    assert gained(watched, *lines) == []
    assert private.read_text("utf-8") == "kept"
    own = "import os\nopen('mine', 'w').write('x'); os.mkdir('a'); os.rename('mine', 'a/mine')\nprint(os.listdir('a'))"
    assert attack(watched, own).stdout == "['mine']\n"


def test_permissions_owners_and_times_of_its_users_files(watched: Watched, tmp_path: Path) -> None:
    """By name, by an open folder, by a file that may be read, by links: all stay."""
    kept = tmp_path / "kept"
    kept.write_text("kept", "utf-8")

    def version() -> bytes:
        with open(os.__file__, "rb") as stream, contextlib.suppress(OSError):
            return fcntl.ioctl(stream, 0x80087601, bytes(8))
        return b""

    code = f"""
import fcntl, os, sys
link = os.open({str(tmp_path)!r}, os.O_PATH)
readable = os.open(os.__file__, os.O_RDONLY)
os.symlink({str(kept)!r}, "link")
places = [{str(tmp_path)!r}, {str(kept)!r}, "link", f"/proc/self/fd/{{link}}", os.__file__, sys.prefix, readable]
for place in places:
    for act in (lambda: os.chmod(place, 0o777), lambda: os.utime(place, (1, 1)), lambda: os.utime(place),
                lambda: os.chown(place, os.getuid(), os.getgid()), lambda: os.setxattr(place, "user.gem", b"x"),
                lambda: os.chmod("kept", 0o777, dir_fd=link), lambda: os.utime("kept", (1, 1), dir_fd=link),
                lambda: fcntl.ioctl(place, 0x40086602, (0x40).to_bytes(8, "little")),
                lambda: fcntl.ioctl(place, 0x40087602, (0x40).to_bytes(8, "little"))):
        try: act()
        except (OSError, TypeError, ValueError): pass
"""
    places = [tmp_path, kept, Path(os.__file__), Path(sys.prefix)]
    before = [(place.stat().st_mode, place.stat().st_mtime_ns, os.listxattr(place)) for place in places]
    before_version = version()
    assert attack(watched, code).status == "ok"
    assert version() == before_version
    assert [(place.stat().st_mode, place.stat().st_mtime_ns, os.listxattr(place)) for place in places] == before


def test_honest_code_copies_and_unpacks_files(watched: Watched) -> None:
    """Modes and times stay as they were made, and nothing fails."""
    code = """
import os, pathlib, shutil, subprocess, tarfile, tempfile, zipfile
pathlib.Path("new").touch(); pathlib.Path("new").touch()
os.makedirs("a/b"); pathlib.Path("a/b/c").write_text("c"); os.chmod("a/b/c", 0o600); os.utime("a/b/c", (1, 1))
shutil.copy("a/b/c", "copied"); shutil.copy2("a/b/c", "copied2"); shutil.copytree("a", "tree")
shutil.move("new", "moved")
with tarfile.open("t.tar.gz", "w:gz") as tar: tar.add("a")
with tarfile.open("t.tar.gz") as tar: tar.extractall("untarred")
with zipfile.ZipFile("z.zip", "w") as archive: archive.write("a/b/c")
with zipfile.ZipFile("z.zip") as archive: archive.extractall("unzipped")
with tempfile.TemporaryDirectory() as folder: shutil.make_archive(folder + "/x", "zip", "a")
subprocess.run("cp -a a copied3 && touch t && chmod +x t && tar xzf t.tar.gz -C tree", shell=True, check=True)
print(*sorted(str(path) for path in pathlib.Path().rglob("c")), pathlib.Path("moved").exists())
"""
    expected = "a/b/c copied3/b/c tree/a/b/c tree/b/c untarred/a/b/c unzipped/a/b/c True\n"
    outcome = attack(watched, code)
    assert (outcome.stdout, outcome.stderr) == (expected, ""), outcome


def test_another_session_of_the_same_user(watched: Watched) -> None:
    """Its folder cannot be opened, though its name be known, and its process cannot be looked into."""
    session = watched.pool.session(SMALL)
    try:
        where = session.run("import os\nopen('mine', 'w').write('private')\nprint(os.getcwd(), os.getpid())").stdout
        folder, pid = where.split()
        code = f"""
import os
seen = []
for act in (lambda: os.listdir({folder!r}), lambda: open({folder!r} + "/mine").read(),
            lambda: os.listdir(os.path.dirname(os.getcwd())), lambda: open("/proc/{pid}/environ").read()):
    try: seen.append(act())
    except OSError: pass
print(seen)
"""
        assert watched.pool.run(code, limits=SMALL).stdout == "[]\n"
        assert session.run("open('mine').read()").value == "'private'"
    finally:
        session.close()
    watched.check()


@pytest.mark.thorough
def test_signals_by_way_of_a_file(watched: Watched, bystander: subprocess.Popen[bytes]) -> None:
    """A file that becomes ready may signal any process of its user: it is given no other owner."""
    code = f"""
import fcntl, os, signal
reading, writing = os.pipe()
for act in (lambda: fcntl.fcntl(reading, fcntl.F_SETOWN, {bystander.pid}),
            lambda: fcntl.ioctl(reading, 0x8901, {bystander.pid}.to_bytes(4, "little")),
            lambda: fcntl.fcntl(reading, 10, signal.SIGKILL)):
    try:
        act()
        print("set")
    except OSError: pass
fcntl.fcntl(reading, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
os.write(writing, b"x")
os.kill(os.getpid(), 0)
"""
    assert attack(watched, code).stdout == ""
    with pytest.raises(subprocess.TimeoutExpired):
        bystander.wait(0.05)


@pytest.mark.thorough
def test_slowing_other_processes_down(watched: Watched, bystander: subprocess.Popen[bytes]) -> None:
    """Their processors, priorities and limits stay."""
    pid = bystander.pid
    before = os.getpriority(os.PRIO_PROCESS, pid), os.sched_getaffinity(pid)
    assert (
        gained(
            watched,
            f"os.sched_setaffinity({pid}, [0])",
            f"os.sched_setscheduler({pid}, 5, os.sched_param(0))",
            f"os.setpriority(os.PRIO_PROCESS, {pid}, 19)",
            "os.setpriority(os.PRIO_USER, 0, 19)",
            f"resource.prlimit({pid}, resource.RLIMIT_NOFILE, (0, 0))",
        )
        == []
    )
    assert (os.getpriority(os.PRIO_PROCESS, pid), os.sched_getaffinity(pid)) == before


def test_services_that_listen_in_the_file_system(watched: Watched) -> None:
    """No socket can be connected by its name, by a path or an abstract one, nor be sent to."""
    name = secrets.token_hex(6)
    with (
        tempfile.TemporaryDirectory(dir="/tmp") as folder,  # a socket's path must be short
        socket.socket(socket.AF_UNIX) as stream,
        socket.socket(socket.AF_UNIX) as abstract,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as datagrams,
    ):
        path = os.path.join(folder, "s")
        stream.bind(path)
        abstract.bind(f"\0{name}")
        datagrams.bind(f"\0{name}-d")
        for listening in (stream, abstract):
            listening.listen()
        datagrams.setblocking(False)
        code = f"""
import socket
reached = []
def attempt(what, act):
    try:
        act()
        reached.append(what)
    except OSError: pass
attempt("path", lambda: socket.socket(socket.AF_UNIX).connect({path!r}))
attempt("abstract", lambda: socket.socket(socket.AF_UNIX).connect("\\0{name}"))
attempt("sent", lambda: socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto(b"x", "\\0{name}-d"))
attempt("pair", lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)[0].sendto(b"x", "\\0{name}-d"))
here, there = socket.socketpair()
here.send(b"works")
print(reached, there.recv(9))
"""
        assert attack(watched, code).stdout == "[] b'works'\n"
        with pytest.raises(BlockingIOError):
            datagrams.recv(1)


@pytest.mark.thorough
def test_usual_code_does_not_notice(watched: Watched) -> None:
    """Imports, temporary files, other programs, threads, its own facts in /proc."""
    code = """
import asyncio, concurrent.futures, ctypes.util, decimal, hashlib, os, sqlite3, ssl, subprocess, sys, tempfile, time
with tempfile.NamedTemporaryFile("w+") as file: print(file.write("x"))
print(subprocess.run([sys.executable, "-c", "import json; print(40 + 2)"], capture_output=True, text=True).stdout)
print(subprocess.run("echo $((1 + 1)) | cat > o; cat o 2>/dev/null", shell=True, capture_output=True, text=True).stdout)
with concurrent.futures.ThreadPoolExecutor(2) as threads: print(list(threads.map(abs, [-1, 2])))
async def one(): return 1
print(asyncio.run(one()), sqlite3.connect("data.db").execute("select 1 + 1").fetchone(), os.cpu_count() > 0)
print("VmRSS" in open("/proc/self/status").read(), open("/dev/stdin").read(), open(os.devnull).read() == "")
"""
    outcome = attack(watched, code, Limits(wall_s=60), stdin="given")
    assert outcome.stdout == "1\n42\n\n2\n\n[1, 2]\n1 (2,) True\nTrue given True\n", outcome


@pytest.mark.thorough
def test_signals_to_itself(watched: Watched) -> None:
    """Are as usual."""
    outcome = attack(watched, "import signal\nsignal.raise_signal(signal.SIGTERM)")
    assert (outcome.status, outcome.signal) == ("killed", signal.SIGTERM.name)
