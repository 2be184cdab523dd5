"""Starting a sandbox: bubblewrap's words, and a keeper in it."""

from __future__ import annotations

import functools
import marshal
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING

from gem_terminal.backends.local import inside
from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    import socket

PYTHON = "/python"
"""Where the interpreter is in a sandbox, when it is not the system's own."""

_PROBE_S = 20.0
_INSTALL = "install bubblewrap ('apt-get install bubblewrap'), or use the backend 'docker'"
# In the order in which they need one another.
_MODULES = (
    "kernel",
    "wire",
    "views",
    "processes",
    "files",
    "compare",
    "programs",
    "keeper",
)
_POWERS = (
    *("CHOWN", "DAC_OVERRIDE", "FOWNER", "FSETID", "KILL", "SETGID", "SETUID", "SETPCAP", "NET_BIND_SERVICE"),
    *("SYS_CHROOT", "SYS_PTRACE", "SYS_ADMIN", "SYS_RESOURCE", "AUDIT_WRITE"),
)
_SYSTEM = ("/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/nix/store", "/gnu/store")
_BOOT = """
import marshal, os, sys, types
channel, owner, source = map(int, sys.argv[1:4])
for number in (channel, owner): os.set_inheritable(number, False)
with open(source, "rb") as file:
    file.seek(0)
    modules = marshal.load(file)
for name, code in modules:
    module = sys.modules[name] = types.ModuleType(name)
    parent, _, last = name.rpartition(".")
    if parent: setattr(sys.modules[parent], last, module)
    if code is None: module.__path__ = []
    else: exec(code, module.__dict__)
module.main(channel, owner)
"""
# Root becomes a user without rights; what that user may not reach is first mounted where it can, seen by nobody else.
_STEP_DOWN = """
import ctypes, os, sys
uid, count = int(sys.argv[1]), int(sys.argv[2])
paths, words = sys.argv[3:3 + count], sys.argv[3 + count:]
libc = ctypes.CDLL(None, use_errno=True)
program = os.open(words[0], os.O_RDONLY)
os.set_inheritable(program, True)
places = {}
if not libc.unshare(0x20000):
    opened = [os.open(path, os.O_PATH) for path in paths]
    done = not libc.mount(None, b"/", None, ctypes.c_ulong(0x44000), None)
    done = done and not libc.mount(b"tmpfs", b"/tmp", b"tmpfs", ctypes.c_ulong(0), b"mode=755,size=1m")
    for number, descriptor in enumerate(opened):
        place = f"/tmp/{number}"
        if done:
            os.mkdir(place)
            source = f"/proc/self/fd/{descriptor}".encode()
            done = not libc.mount(source, place.encode(), None, ctypes.c_ulong(0x5000), None)
            places[paths[number]] = place
        os.close(descriptor)
    if not done: sys.exit("cannot mount: " + os.strerror(ctypes.get_errno()))
os.setgroups([])
os.setresgid(uid, uid, uid)
os.setresuid(uid, uid, uid)
os.execve(program, [places.get(word, word) for word in words], dict(os.environ))
"""


def check() -> str:
    """Return where bubblewrap is.

    Raises:
        EngineError: It is not installed, or this is not Linux; says what to do.
    """
    if not sys.platform.startswith("linux"):
        raise EngineError(f"the backend 'local' needs Linux, and this is {sys.platform}: use the backend 'docker'")
    program = shutil.which("bwrap")
    if program is None:
        raise EngineError(f"bubblewrap is not on the PATH: {_INSTALL}")
    return program


@functools.cache
def uid() -> int | None:
    """Return the user that sandboxes run as: None for this process's own, which is not root, else one nobody has.

    Raises:
        EngineError: This is root, and there is no other user it could become.
    """
    if os.geteuid() != 0:
        return None
    ranges = [list(map(int, line.split())) for line in Path("/proc/self/uid_map").read_text("ascii").splitlines()]
    for wanted in (1_729_000_000, 64_900):
        if any(first <= wanted < first + length for first, _, length in ranges):
            return wanted
    raise EngineError(f"root has no other user id to run sandboxes as here: run as an ordinary user, or {_INSTALL}")


@functools.cache
def interpreter() -> tuple[str, str]:
    """Return this interpreter's own folder, and where its program is in a sandbox."""
    base = os.path.realpath(sys.base_prefix)
    program = os.path.realpath(getattr(sys, "_base_executable", None) or sys.executable)
    return (base, program) if base == "/usr" else (base, f"{PYTHON}/bin/{os.path.basename(program)}")


@functools.cache
def python() -> str:
    """Return the interpreter that programs in a sandbox find: the system's, or ours where it has none."""
    return "/usr/bin/python3" if os.path.exists("/usr/bin/python3") else interpreter()[1]


@functools.cache
def libraries() -> str:
    """Return where our interpreter's library is in a sandbox; empty where it needs none."""
    shared = sysconfig.get_config_var("Py_ENABLE_SHARED") and interpreter()[0] != "/usr"
    return f"{PYTHON}/lib" if shared else ""


@functools.cache
def system() -> tuple[str, ...]:
    """Return the paths of the host that are shown to programs, read-only, as they are in a sandbox."""
    found = ["/usr", *(path for path in _SYSTEM if os.path.isdir(path) and not os.path.islink(path))]
    return (*found, PYTHON) if python().startswith(PYTHON) else tuple(found)


@functools.cache
def links() -> tuple[tuple[str, str], ...]:
    """Return the links of the host's root to its programs, as ``/bin``, and where they lead."""
    return tuple((path, os.readlink(path)) for path in _SYSTEM if os.path.islink(path))


@functools.cache
def probe() -> None:
    """See whether a sandbox can be started at all; asks once.

    Raises:
        EngineError: It cannot; says what to do.
    """
    program = check()
    words = [program, "--unshare-user", "--uid", "0", "--gid", "0", "--unshare-pid", "--unshare-net", "--as-pid-1"]
    words += [
        "--cap-add",
        "CAP_SYS_ADMIN",
        "--ro-bind",
        "/",
        "/",
        "--proc",
        "/proc",
        "--dev",
        "/dev",
        "--",
        "/bin/true",
    ]
    try:
        done = subprocess.run(
            [*_as_user([]), *words],
            check=False,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=_PROBE_S,
            cwd="/",
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise cannot(str(error)) from error
    if done.returncode:
        raise cannot(" ".join(done.stderr.decode("utf-8", "replace").split())[-500:])


def launch(
    folder: Path, hostname: str, channel: socket.socket, template: Path | None = None
) -> subprocess.Popen[bytes]:
    """Start a sandbox over a folder.

    Args:
        folder: The machine's, which belongs to the sandbox's user.
        hostname: The name of the machine inside.
        channel: The keeper's end of a socket.
        template: Folder that the keeper copies the root from.

    Raises:
        EngineError: It cannot be started.
    """
    program = check()
    owner = os.pidfd_open(os.getpid())
    code = os.memfd_create("gem", 0)
    try:
        os.write(code, _code())
        descriptors = (channel.fileno(), owner, code)
        # The last word only tells one machine's processes from another's, for whoever lists them.
        words = [*_bubblewrap(program, folder, template, hostname), *map(str, descriptors), folder.name]
        paths = [str(path) for path in (folder, interpreter()[0], template) if path is not None]
        return subprocess.Popen(
            [*_as_user(paths), *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=descriptors,
            cwd="/",
            env={"PATH": os.defpath, "LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", "")},
            start_new_session=True,  # an interrupt of the library's terminal is for the library, which then ends this
        )
    except OSError as error:
        raise EngineError(f"bubblewrap cannot be started: {error}; {_INSTALL}") from error
    finally:
        os.close(owner)
        os.close(code)


def _as_user(paths: list[str]) -> list[str]:
    """Return the words before others that have root become the sandbox's user, who reaches some paths then."""
    user = uid()
    if user is None:
        return []
    return [sys.executable, "-I", "-S", "-c", _STEP_DOWN, str(user), str(len(paths)), *paths]


def _bubblewrap(program: str, folder: Path, template: Path | None, hostname: str) -> list[str]:
    words = [program, "--unshare-user", "--uid", "0", "--gid", "0", "--unshare-pid", "--as-pid-1", "--unshare-net"]
    words += ["--unshare-ipc", "--unshare-uts", "--unshare-cgroup-try", "--hostname", hostname, "--clearenv"]
    words += ["--setenv", "LC_ALL", "C.UTF-8"]
    if libraries():
        words += ["--setenv", "LD_LIBRARY_PATH", libraries()]
    words += [word for power in _POWERS for word in ("--cap-add", f"CAP_{power}")]
    for path in dict.fromkeys((*system(), *([PYTHON] if interpreter()[0] != "/usr" else []))):
        words += ["--ro-bind", interpreter()[0] if path == PYTHON else path, path]
    for path, target in links():
        words += ["--symlink", target, path]
    words += ["--ro-bind-try", "/etc/ld.so.cache", "/etc/ld.so.cache", "--proc", "/proc", "--dev", "/dev"]
    words += ["--bind", str(folder), "/scratch", "--dir", "/view", "--dir", "/tmp"]
    if template is not None:
        words += ["--ro-bind", str(template), "/template"]
    return [*words, "--chdir", "/", "--", interpreter()[1], "-I", "-S", "-B", "-c", _BOOT]


@functools.cache
def _code() -> bytes:
    """Return the modules that run in a sandbox, compiled: the interpreter there is this one."""
    folder, package = Path(inside.__file__).parent, inside.__name__
    parents = [package.rsplit(".", count)[0] for count in range(package.count("."), 0, -1)] + [package]
    modules: list[tuple[str, object]] = [(name, None) for name in parents]
    for name in _MODULES:
        source = (folder / f"{name}.py").read_text("utf-8")
        modules.append((f"{package}.{name}", compile(source, name, "exec", dont_inherit=True)))
    return marshal.dumps(modules)


def failure(process: subprocess.Popen[bytes]) -> str:
    """Return what a sandbox that has ended said last, in one line."""
    if process.stderr is None:
        return ""
    os.set_blocking(process.stderr.fileno(), False)
    try:
        data = os.read(process.stderr.fileno(), 100_000)
    except (BlockingIOError, ValueError, OSError):
        return ""
    return " ".join(data.decode("utf-8", "replace").split())[-500:]


def cannot(said: str) -> EngineError:
    """Return the error of a sandbox that did not come up."""
    advice = "where user namespaces are forbidden, allow them ('sysctl kernel.unprivileged_userns_clone=1', or "
    advice += "'sysctl kernel.apparmor_restrict_unprivileged_userns=0'), or use the backend 'docker'"
    return EngineError(f"the sandbox did not start: {said or 'no reason given'}; {advice}")
