"""Attacks on files: writing, deleting and reading what is not the call's own.

Each is really tried; afterwards the pool still serves, and no process, file or memory is left.
"""

from __future__ import annotations

import os
import secrets
import sys
from pathlib import Path

import pytest
from python_levels import SMALL, Watched, attack, each_level, gained, new_pool

from gem_tools.python.inside import confine

watched = each_level()


@pytest.mark.thorough
def test_filling_the_folder(watched: Watched) -> None:
    """In a folder in memory the sum has an exact limit, and so has the number of files."""
    if watched.pool.level != "bubblewrap":
        pytest.skip("the level 'process' has no limit for all files together")
    code = """
import errno, os
written = 0
try:
    for number in range(100):
        with open(f"f{number}", "wb", buffering=0) as stream:
            for _ in range(4):
                written += stream.write(bytes(1 << 20))
except OSError as error:
    print(errno.errorcode[error.errno], written >> 20)
for name in os.listdir(): os.unlink(name)
try:
    for number in range(10000): os.mkdir(f"d{number}")
except OSError as error:
    print(errno.errorcode[error.errno], number < 4096)
try:
    with open("/dev/shm/x", "wb") as stream: stream.write(bytes(32 << 20))
except OSError as error:
    print(errno.errorcode[error.errno])
"""
    assert attack(watched, code).stdout == "ENOSPC 16\nENOSPC True\nENOSPC\n"


@pytest.mark.few(1)
@pytest.mark.root
def test_writing_and_deleting_outside_the_folder(watched: Watched, tmp_path: Path) -> None:
    """Neither the system's files nor those of whoever runs this change."""
    precious = tmp_path / "precious"
    precious.write_text("kept", "utf-8")
    tmp_path.chmod(0o755 if watched.pool.level == "process" else 0o777)
    folders = ["/usr", "/etc", "/bin", "/venv", sys.prefix, sys.base_prefix, os.path.dirname(os.__file__), "/", "/dev"]
    folders += [str(tmp_path), os.getcwd(), "/root", "/home", "/var", "/proc", "/sys"]
    lines = [f"open({place!r} + '/gem-was-here', 'w')" for place in folders]
    changed = "mode = os.stat({0!r}).st_mode; os.chmod({0!r}, mode ^ 0o022); call(-(os.stat({0!r}).st_mode == mode))"
    lines += [changed.format(place) for place in folders]
    for place in (os.__file__, sys.executable, str(precious), "/etc/passwd", "/usr/bin/env"):
        lines += [f"os.unlink({place!r})", f"os.rename({place!r}, {place + 'x'!r})", f"os.truncate({place!r}, 0)"]
        lines += [f"open({place!r}, 'r+b')"]
    assert gained(watched, *lines) == []
    assert precious.read_text("utf-8") == "kept"


@pytest.mark.thorough
def test_reading_files_of_the_parent(watched: Watched, tmp_path: Path) -> None:
    """What only its owner may read stays unread, by its name, through links, and through /proc."""
    hidden = tmp_path / "secret"
    hidden.write_text("secret", "utf-8")
    hidden.chmod(0o600)
    with hidden.open() as kept_open:
        parent = f"/proc/{os.getpid()}"
        paths = [str(hidden), "/etc/shadow", "/proc/1/environ", f"/proc/self/root{hidden}", "/proc/kcore", "/dev/mem"]
        paths += [f"{parent}/{name}" for name in (f"fd/{kept_open.fileno()}", "environ", "mem", f"root{hidden}")]
        lines = [f"open({path!r}, 'rb').read(4096)" for path in paths]
        link = f"os.path.lexists('link') or os.symlink({str(hidden)!r}, 'link'); open('link').read()"
        assert gained(watched, *lines, link, "open(f'/proc/{os.getppid()}/environ').read()") == []


@pytest.mark.thorough
def test_reading_the_environment(watched: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """Variables of the library's process are nowhere in the process that runs code."""
    secret = secrets.token_hex(16)
    monkeypatch.setenv("GEM_SECRET", secret)
    fresh = new_pool(watched.pool.sandbox)
    try:
        code = """
import ctypes, os
print(sorted(os.environ))
try:
    print(open("/proc/self/environ").read())
except OSError:
    pass
environ = ctypes.POINTER(ctypes.c_char_p).in_dll(ctypes.CDLL(None), "environ")
place = 0
while environ[place]:
    print(environ[place])
    place += 1
"""
        outcome = fresh.run(code)
        assert outcome.ok
        assert "GEM_" not in outcome.stdout
        assert secret not in outcome.stdout
        assert "PYTHONHASHSEED" in outcome.stdout
    finally:
        fresh.close()


@pytest.mark.thorough
def test_one_call_reads_another_ones_data(watched: Watched) -> None:
    """Neither files of an earlier call, nor its code or output, are in the memory or the folder of the next."""
    secret = secrets.token_hex(8)
    half, rest = secret[:8], secret[8:]
    first = watched.pool.run(f"open('note', 'w').write('{secret}')\nprint('{secret}')", stdin=secret)
    assert first.stdout == f"{secret}\n"
    # Every readable page is looked at; the marker is put together so that the search does not find itself.
    code = f"""
import gc, os, sys
wanted = {half!r} + {rest!r}
seen = [path for path, _, names in os.walk(os.getcwd()) for name in names]
hits = 0
for thing in gc.get_objects():
    if isinstance(thing, dict):
        hits += sum(1 for v in list(thing.values()) if isinstance(v, str) and v == wanted and v is not wanted)
        hits += sum(1 for v in list(thing.values()) if isinstance(v, bytes) and wanted.encode() in v)
print(seen, hits)
"""
    assert attack(watched, code).stdout == "[] 0\n"


@pytest.mark.root
def test_a_session_is_out_of_reach_of_other_calls(watched: Watched) -> None:
    """Its folder, its processes and its memory."""
    session = watched.pool.session(SMALL)
    try:
        where = session.run("import os\nopen('mine', 'w').write('private')\nprint(os.getcwd())").stdout
        folder = where.strip()
        code = f"""
import os, signal
try:
    print(os.listdir({folder!r}) if {folder!r} != os.getcwd() else sorted(os.listdir()))
except OSError:
    print([])
for number in {{*range(2, 400)}} - {{os.getpid()}}:
    try: os.kill(number, 0); print(number)
    except OSError: pass
"""
        outcome = watched.pool.run(code, limits=SMALL)
        assert outcome.stdout == "[]\n"
        assert session.run("open('mine').read()").value == "'private'"
    finally:
        session.close()
    watched.check()


@pytest.mark.thorough
def test_tricks_with_files_in_the_folder(watched: Watched) -> None:
    """Links, pipes, sockets, deep folders and closed permissions go with the folder."""
    code = """
import os, socket
os.symlink("/", "root"); os.symlink("loop", "loop"); os.mkfifo("pipe"); os.link("pipe", "pipe2")
s = socket.socket(socket.AF_UNIX)
try: s.bind("sock")
except PermissionError: pass  # only where sockets have addresses
top = os.open(".", os.O_RDONLY)
for _ in range(2000):
    os.mkdir("d"); os.chdir("d")
os.fchdir(top)
os.mkdir("closed"); open("closed/file", "w").close(); os.chmod("closed", 0); os.chmod(".", 0)
"""
    assert attack(watched, code).status == "ok"


@pytest.mark.thorough
def test_leaving_a_file_without_a_trace_in_times(watched: Watched) -> None:
    """A file made in the same tick of the kernel's clock as its folder, or with the times put back, goes as well."""
    if watched.pool.level != "bubblewrap":
        pytest.skip("each call has a folder of its own")
    code = "import os\nat = os.stat('.').st_mtime_ns\nopen('random.py', 'w').write('1 / 0')\nos.utime('.', ns=(at, at))"
    assert attack(watched, code).status == "ok"


@pytest.mark.root
def test_places_that_everyone_may_write_to(watched: Watched) -> None:
    """Nothing can be left in them for later calls or for others, and what is left in shared memory is removed."""
    if watched.pool.level == "process" and not watched.pool.cells[0].ready["walled"]:
        pytest.skip("this kernel has no Landlock")
    name = f"gem-{secrets.token_hex(8)}"
    code = f"""
import os
for place in ("/tmp", "/var/tmp", "/dev/shm", "/run/lock", "/var/lock", "/dev/mqueue"):
    for act in (lambda path: open(path, "w"), os.mkdir):
        try: act(os.path.join(place, {name!r} + act.__name__.strip("<>")))
        except OSError: pass
os.chdir("/dev/shm")
for _ in range(50):
    os.mkdir({name!r}); os.chdir({name!r})
"""
    attack(watched, code)
    for place in ("/tmp", "/var/tmp", "/dev/shm", "/run/lock", "/var/lock", "/dev/mqueue"):
        if os.path.isdir(place):
            assert not [left for left in os.listdir(place) if left.startswith(name)], place


def test_removing_folders_of_any_depth_and_permission(tmp_path: Path) -> None:
    """Without a path that grows too long, and without changing the working folder of this process."""
    top = confine.make_folder(str(tmp_path), None)
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(top)
        for _ in range(1200):
            os.mkdir("deep" * 20)
            Path("file").touch()
            os.symlink("/", "link")
            os.chdir("deep" * 20)
    finally:
        os.fchdir(here)
        os.close(here)
    for name in ("closed", "other"):
        Path(top, name, "inner").mkdir(parents=True)
        Path(top, name).chmod(0)
    Path(top).chmod(0)
    outside = tmp_path / "outside"
    outside.mkdir()
    before = os.getcwd()
    confine.remove_folder(top)
    assert os.listdir(tmp_path) == ["outside"]
    assert os.getcwd() == before
    confine.remove_folder(top)
