"""The containers of the level ``docker``: how the client is told to start one, and that none of them is left behind.

A container ends by itself when its standard input does, and the engine then removes it. What that does not reach (a
client that was killed between making a container and starting it, an engine that was down, a keeper that hangs) is
removed by name, and what processes have left that are dead now, when the next one starts.
"""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from gem_tools.python.errors import Unavailable

LABEL = "gem-tools=python"
"""Marks every container of ours."""

OWNER = "gem-tools.owner"
"""Label that says which process a container belongs to."""

_ANSWER_S = 10.0
_ABANDONED_S = 3600.0
# The image's own search path is kept; all else that it, or the client's configuration (proxies), would set is not.
_START = 'exec env -i "PATH=$PATH" "$@"'
# Places that are writable for all by themselves, where a call could leave something for another to read.
_CLOSE = "chmod 0711 /tmp; chmod 0700 /dev/mqueue; "
# What the process that stands between needs to run each call as a user of its own, and to clear up after it.
_POWERS = ("SETUID", "SETGID", "KILL", "CHOWN", "DAC_OVERRIDE", "FOWNER")

# As Docker, and Podman, say so.
_NO_IMAGE = ("no such image", "no such object", "image not known")

_lock = threading.Lock()
_left: set[str] = set()
"""Containers of this process that could not be removed yet."""


def client() -> str:
    """Return the program that speaks to the engine.

    Raises:
        Unavailable: There is none.
    """
    program = shutil.which("docker")
    if program is None:
        raise Unavailable("the command 'docker' is not on the PATH: install Docker's client and start an engine")
    return program


def run_words(
    name: str,
    image: str,
    environment: Mapping[str, str],
    program: Sequence[str],
    *,
    user: int | None,
    memory_mb: int,
    folder_mb: int,
    folder_files: int,
) -> list[str]:
    """Return the command that runs a program in a container, closed off from all else.

    Args:
        name: Of the container.
        image: Of the container; it is never pulled.
        environment: All that the program finds, besides the image's search path.
        program: With its arguments.
        user: Who runs it; None for root with the rights to become others.
        memory_mb: Limit of all its processes together, in megabytes.
        folder_mb: Size of ``/tmp``, the only place to write, in megabytes.
        folder_files: Limit of the files and folders in it.
    """
    words = [client(), "run", "--rm", "--interactive", "--pull", "never", "--name", name]
    words += ["--label", LABEL, "--label", f"{OWNER}={owner()}", "--hostname", "sandbox"]
    # No log: the engine would keep all that passes between the container and this process on its disk.
    words += ["--network", "none", "--ipc", "none", "--read-only", "--log-driver", "none", "--cap-drop", "ALL"]
    words += ["--security-opt", "no-new-privileges", "--pids-limit", "1024", "--ulimit", "core=0"]
    words += ["--memory", f"{memory_mb}m", "--memory-swap", f"{memory_mb}m", "--workdir", "/"]
    if user is None:
        words += ["--user", "0:0", *(word for power in _POWERS for word in ("--cap-add", power))]
    else:
        words += ["--user", f"{user}:{user}"]
    words += ["--tmpfs", f"/tmp:rw,exec,nosuid,nodev,mode=1777,size={folder_mb}m,nr_inodes={folder_files}"]
    words += ["--entrypoint", "/bin/sh", image, "-c", (_CLOSE if user is None else "") + _START, "sh"]
    return [*words, *(f"{name}={value}" for name, value in environment.items()), *program]


def new_name() -> str:
    """Return a name for a container that no other has."""
    return f"gem-python-{secrets.token_hex(8)}"


def check(image: str) -> None:
    """See to it that an engine answers and has an image, and remove what dead processes have left there.

    Raises:
        Unavailable: It does not answer, or has no such image; the message says what to do.
    """
    program = client()
    try:
        done = _ask(program, "image", "inspect", "--format", "{{.Id}}", image)
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = f"the container engine does not answer ({type(error).__name__}): start it, or set DOCKER_HOST"
        raise Unavailable(reason) from error
    if done.returncode:
        words = " ".join(done.stderr.split())[:300]
        if any(said in words.lower() for said in _NO_IMAGE):
            raise Unavailable(f"the image {image!r} is not there: 'docker pull {image}', or name another ({words})")
        raise Unavailable(f"the container engine does not answer: start it, or set DOCKER_HOST ({words})")
    reap()


def remove(*names: str) -> None:
    """Remove containers at once, whatever runs in them; those that the engine cannot remove now are kept in mind."""
    with _lock:
        _left.update(names)
        wanted = sorted(_left)
    if not wanted:
        return
    try:
        # One that is gone already is no failure.
        done = _ask(client(), "rm", "--force", "--volumes", *wanted)
    except (OSError, subprocess.TimeoutExpired, Unavailable):
        return
    if not done.returncode or all("no such container" in line.lower() for line in done.stderr.splitlines()):
        with _lock:
            _left.difference_update(wanted)


def reap() -> None:
    """Remove the containers whose process is dead, on this machine, or that were made long ago and never ran."""
    listing = ["ps", "--all", "--no-trunc", "--filter", f"label={LABEL}", "--format"]
    try:
        done = _ask(client(), *listing, f'{{{{.Names}}}}\t{{{{.State}}}}\t{{{{.CreatedAt}}}}\t{{{{.Label "{OWNER}"}}}}')
    except (OSError, subprocess.TimeoutExpired, Unavailable):
        return
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    remove(*(row[0] for row in rows if len(row) == 4 and _is_left(*row[1:])))


def _is_left(state: str, created: str, owned_by: str) -> bool:
    if _is_dead(owned_by):
        return True
    try:
        at = datetime.strptime(" ".join(created.split()[:3]), "%Y-%m-%d %H:%M:%S %z")
    except ValueError:
        return False
    return state != "running" and time.time() - at.timestamp() > _ABANDONED_S


def owner() -> str:
    """Return what names this process among all that were ever started on this machine; empty where that is unknown."""
    place = _place()
    started = _started(os.getpid())
    return f"{place}:{os.getpid()}:{started}" if place and started else ""


def _is_dead(owned_by: str) -> bool:
    """Whether a process is surely dead; of those of other machines, or other containers, nothing is known."""
    place, _, rest = owned_by.partition(":")
    pid, _, started = rest.partition(":")
    return bool(place) and place == _place() and pid.isdecimal() and _started(int(pid)) != started


def _place() -> str:
    """Return what is the same for all processes that see one another: this start of the machine, and the namespace."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
        return f"{boot}/{os.stat('/proc/self/ns/pid').st_ino}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Return when a process was started, in ticks of the kernel; empty where there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


def _ask(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        capture_output=True,
        stdin=subprocess.DEVNULL,
        timeout=_ANSWER_S,
        check=False,
        encoding="utf-8",
        errors="replace",
    )
