"""The levels of isolation: how each is started, whether it can be, and what to do where it cannot."""

from __future__ import annotations

import os
import secrets
import shutil
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gem_tools.python import docker, inside
from gem_tools.python.errors import Unavailable
from gem_tools.python.hidden import hidden_folders
from gem_tools.python.inside.runner import NAMED_INPUT

LEVELS = ("bubblewrap", "docker", "process")
"""From the strongest to the weakest."""

DOCKER_IMAGE = f"python:{sys.version_info[0]}.{sys.version_info[1]}-slim"

_MODULES = ("wire", "kernel", "syscalls", "confine", "walls", "runner", "usage", "child", "server")
"""In the order in which they need one another."""

_PACKAGE = inside.__name__
_BOOT = """
import json, os, sys, types
def take(count):
    data = b""
    while len(data) < count:
        piece = os.read(0, count - len(data))
        if not piece: os._exit(0)
        data += piece
    return data
job = json.loads(take(int.from_bytes(take(4), "big")))
for name, source in job["sources"]:
    module = types.ModuleType(name)
    sys.modules[name] = module
    parent, _, last = name.rpartition(".")
    if parent: setattr(sys.modules[parent], last, module)
    if source is None: module.__path__ = []
    else: exec(compile(source, name, "exec"), module.__dict__)
sys.modules[name].main(job["settings"])
"""
_OPTIONS = ("-s", "-P", "-B")
_ENVIRONMENT = {
    "PATH": "/usr/local/bin:/usr/bin:/bin",
    "LANG": "C.UTF-8",
    # There is no list of users; libraries ask for a name.
    "LOGNAME": "sandbox",
    "PYTHONHASHSEED": "0",
    # A library that starts threads at its import could not be forked.
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    # Each arena of the allocator takes address space, which is limited.
    "MALLOC_ARENA_MAX": "2",
    "OPENBLAS_MAIN_FREE": "1",
}
_SYSTEM = ("/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/nix/store", "/gnu/store")
_ETC = ("/etc/ld.so.cache", "/etc/alternatives", "/etc/localtime", "/etc/timezone")
_FONTS = ("/etc/fonts", "/var/cache/fontconfig")
_DEVICES = ("null", "zero", "full", "random", "urandom")


@dataclass(frozen=True)
class Launch:
    """How a sandbox is started.

    Args:
        level: Its name.
        command: Program and arguments.
        settings: What is told to the first process inside.
        popen: Further keywords for ``subprocess.Popen``.
        base: Folder on disk that the sandbox owns; None where it has none.
        note: What is special about this way of the level, in a few words.
        container: Name of the container that it is; None where it is none.
    """

    level: str
    command: Sequence[str]
    settings: Mapping[str, Any]
    popen: Mapping[str, Any] = field(default_factory=dict)
    base: str | None = None
    note: str = ""
    container: str | None = None


def bootstrap(settings: Mapping[str, Any]) -> bytes:
    """Return what a sandbox reads first: the modules that run in it, as text, and its settings."""
    import json

    folder = Path(inside.__file__).parent
    parents = [_PACKAGE.rsplit(".", count)[0] for count in (2, 1)] + [_PACKAGE]
    sources: list[tuple[str, str | None]] = [(name, None) for name in parents]
    sources += [(f"{_PACKAGE}.{name}", (folder / f"{name}.py").read_text("utf-8")) for name in _MODULES]
    data = json.dumps({"sources": sources, "settings": dict(settings)}).encode("ascii")
    return len(data).to_bytes(4, "big") + data


# Bubblewrap.


def _bubblewrap(options: Mapping[str, Any]) -> Launch:
    """Set up by root, so that it may lie anywhere, code runs as a user that owns nothing; else in a user namespace."""
    if os.geteuid() == 0:
        uid = _spare_uid(1)
        if uid is None:
            raise Unavailable("no other user id can be taken here")
        powers = ("SYS_ADMIN", "SYS_PTRACE", "SETUID", "SETGID", "KILL", "CHOWN", "DAC_OVERRIDE", "FOWNER")
        rights = [word for power in (*powers, "SYS_RESOURCE") for word in ("--cap-add", f"CAP_{power}")]
    else:
        uid = None
        # The second right is to see how much of their memory processes share.
        rights = ["--unshare-user", "--uid", "1000", "--gid", "1000", "--cap-add", "CAP_SYS_ADMIN"]
        rights += ["--cap-add", "CAP_SYS_PTRACE"]
    settings = _settings(options, namespaces=True, uid=uid)
    return Launch("bubblewrap", [*_bubblewrap_words(), *rights, "--", *_venv_python()], settings)


def _bubblewrap_words() -> list[str]:
    program = shutil.which("bwrap")
    if program is None:
        raise Unavailable("bubblewrap is not on the PATH: install the package 'bubblewrap' of your system")
    words = [program, "--unshare-pid", "--unshare-net", "--unshare-ipc", "--unshare-uts", "--unshare-cgroup-try"]
    words += ["--die-with-parent", "--hostname", "sandbox", "--clearenv"]
    for name, value in _ENVIRONMENT.items():
        words += ["--setenv", name, value]
    mounts = _mounts()
    for path in _above([target for _, target in mounts] + ["/dev/null", "/etc/localtime", "/var/tmp", *_FONTS]):
        # By itself it would make some of these for their owner alone, who may be another than runs the code.
        words += ["--perms", "0755", "--dir", path]
    for source, target in mounts:
        words += ["--ro-bind", source, target]
    for path in filter(os.path.lexists, _SYSTEM):
        words += ["--symlink", os.readlink(path), path] if os.path.islink(path) else ["--ro-bind", path, path]
    for path in (*_ETC, *_FONTS):
        words += ["--ro-bind-try", path, path]
    for name in _DEVICES:
        words += ["--dev-bind", f"/dev/{name}", f"/dev/{name}"]
    if _in_venv():
        words += ["--perms", "0755", "--dir", "/venv/bin"]
        words += ["--symlink", os.path.realpath(_base_python()), "/venv/bin/python"]
    for path in hidden_folders(mounts):
        words += ["--perms", "0555", "--tmpfs", path, "--remount-ro", path]
    words += ["--symlink", "/tmp", "/dev/shm", "--symlink", "/tmp", "/var/tmp"]
    # There is no /proc to lead to it; the file is there for code that asks for it.
    words += ["--symlink", f"/tmp/{NAMED_INPUT}", "/dev/stdin"]
    words += ["--dir", "/dev/fd", "--symlink", "../stdin", "/dev/fd/0"]
    return [*words, "--proc", "/proc", "--dir", "/tmp", "--remount-ro", "/", "--chdir", "/"]


def _mounts() -> list[tuple[str, str]]:
    """Return what of the file system is shown, and where: the system's programs, and this interpreter's libraries."""
    found = [("/usr", "/usr")]
    places = [("lib", "lib"), ("lib64", "lib64"), ("pyvenv.cfg", "pyvenv.cfg")]
    if _in_venv():
        # In a place of its own: no path of this machine shows, and a venv below /tmp is not hidden by the folder.
        found += [(os.path.join(sys.prefix, name), f"/venv/{target}") for name, target in places]
    bases = dict.fromkeys([sys.base_prefix, sys.base_exec_prefix])
    found += [
        (os.path.join(base, name), os.path.join(base, name)) for base in bases for name in ("bin", "lib", "lib64")
    ]
    base = {"base": sys.base_prefix, "platbase": sys.base_exec_prefix, "installed_base": sys.base_prefix}
    folders = [sysconfig.get_path(name, vars=base) for name in ("stdlib", "platstdlib")]
    found += [(folder, folder) for folder in folders]
    found.append((os.path.dirname(os.path.realpath(_base_python())),) * 2)
    kept: list[tuple[str, str]] = []
    for source, target in found:
        below = any(target == above or target.startswith(f"{above}/") for _, above in kept)
        if not below and os.path.exists(source) and not os.path.islink(source):
            if target.startswith("/tmp/"):
                raise Unavailable(f"the interpreter lies in {target}; use one outside /tmp")
            kept.append((source, target))
    return kept


def _above(paths: Sequence[str]) -> list[str]:
    """Return the folders that some paths lie in, the outer ones first."""
    return sorted({str(parent) for path in paths for parent in Path(path).parents} - {"/"})


def _in_venv() -> bool:
    return sys.prefix != sys.base_prefix


def _base_python() -> str:
    return getattr(sys, "_base_executable", None) or sys.executable


def _venv_python() -> list[str]:
    return ["/venv/bin/python" if _in_venv() else os.path.realpath(sys.executable), *_OPTIONS, "-c", _BOOT]


# Docker.


def _docker(options: Mapping[str, Any]) -> Launch:
    """Root of the container, with few of its rights, runs each call as a user of its own."""
    name = docker.new_name()
    words = docker.run_words(
        name,
        options["image"],
        {key: value for key, value in _ENVIRONMENT.items() if key != "PATH"},
        ["python3", *_OPTIONS, "-c", _BOOT],
        folder_mb=4 * options["folder_mb"],
        folder_files=4 * options["folder_files"],
    )
    # The kernel counts the processes of a user in all containers together; engines without root's rights have 65,536.
    first, uids = 10_000 + secrets.randbelow(50) * 1000, 1000
    base = f"/tmp/gem-{secrets.token_hex(8)}"
    settings = _settings(options, namespaces=False, uid=first, uids=uids, base=base, own_machine=True)
    return Launch("docker", words, settings, container=name, note=f"image {options['image']}")


# A process with limits.


def _process(options: Mapping[str, Any]) -> Launch:
    if not sys.platform.startswith("linux"):
        raise Unavailable(f"the sandboxes need Linux, and this is {sys.platform}")
    # One more that no call has, to signal the others as.
    uids = 1000
    uid = _spare_uid(uids + 1) if os.geteuid() == 0 else None
    hidden, shown = _to_hide() if uid is not None else ("", [])
    base = os.path.join(tempfile.gettempdir(), f"gem-python-{os.getpid()}-{secrets.token_hex(8)}")
    settings = _settings(options, namespaces=False, uid=uid, base=base, uids=uids, hidden=hidden, shown=shown)
    popen = {"env": _ENVIRONMENT, "cwd": "/"}
    note = "each call as a user of its own" if uid is not None else "as your own user"
    return Launch("process", [sys.executable, *_OPTIONS, "-c", _BOOT], settings, popen, base, note)


def _to_hide() -> tuple[str, list[str]]:
    """Return a folder that users without rights may not enter, and the folders of this interpreter in it."""
    places = {sys.prefix, sys.base_prefix, *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib"))}
    found: dict[str, list[str]] = {}
    for place in sorted(filter(os.path.isdir, map(os.path.realpath, places))):
        closed = [
            str(path) for path in (*reversed(Path(place).parents), Path(place)) if not path.stat().st_mode & 0o001
        ]
        if closed:
            found.setdefault(closed[0], []).append(place)
    for folder, shown in found.items():
        if len(found) > 1 or folder in shown:
            raise Unavailable(
                f"code would run as a user who may not enter {folder}, where this interpreter is: "
                f"'chmod o+x {folder}', or use an interpreter elsewhere"
            )
        return folder, [place for place in shown if not any(place.startswith(f"{other}/") for other in shown)]
    return "", []


# All levels.


def _settings(options: Mapping[str, Any], *, namespaces: bool, uid: int | None, **further: Any) -> dict[str, Any]:
    """Return what the first process inside is told of its level.

    ``namespaces``: calls are kept apart by these. ``uid`` and ``uids``: the first of the users that code runs as, and
    how many there are. ``same_user``: code runs as the user of all else. ``own_machine``: all that runs there is of the
    sandbox. ``base``: folder that holds those of calls. ``hidden`` and ``shown``: see ``confine.hide``.
    """
    same_user = not namespaces and uid is None
    table: dict[str, Any] = {
        "namespaces": namespaces,
        "uid": uid,
        "uids": 1,
        "same_user": same_user,
        "own_machine": False,
    }
    table |= {"base": "", "hidden": "", "shown": []}
    return {**table, **{name: options[name] for name in ("preload", "folder_mb", "folder_files")}, **further}


def _spare_uid(count: int) -> int | None:
    """Return the first of some user ids in a row that nobody has, as far as can be known; only root can take them."""
    try:
        ranges = [list(map(int, line.split())) for line in Path("/proc/self/uid_map").read_text("ascii").splitlines()]
    except (OSError, ValueError):
        return None
    start, _, length = max(ranges, key=lambda each: each[2])
    if start + length > 2_000_000_000:
        return 1_000_000_000 + secrets.randbelow(900_000) * 1000
    return start + length - count - secrets.randbelow(100) - 1 if length > 2000 + count else None


def launch(level: str, options: Mapping[str, Any]) -> Launch:
    """Return how one more sandbox of a level is started.

    Args:
        level: One of ``LEVELS``.
        options: ``preload``, ``image``, and the default size of the folder.

    Raises:
        Unavailable: It cannot be started here.
    """
    return {"bubblewrap": _bubblewrap, "docker": _docker, "process": _process}[level](options)
