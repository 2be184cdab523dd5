"""The containers of the level ``docker``: how the client is told to start one, and that none of them is left behind.

A container ends by itself when its standard input does, however its process came to its end, and the engine then
removes it. One that was made and never started is removed by a later start, by its label.
"""

from __future__ import annotations

import contextlib
import secrets
import shutil
import subprocess
from collections.abc import Mapping, Sequence

from gem_core.errors import MissingRequirementError
from gem_tools.container_engine import find_engine
from gem_tools.python.errors import Unavailable

LABEL = "gem-tools=python"
"""Label of every container that this plugin starts."""

_ANSWER_S = 10.0
_LEFT_FOR = "1h"
_MEMORY = "4096m"
"""Limit of all processes of a container together."""

# The image's own search path is kept; all else that it, or the client's configuration (proxies), would set is not.
_START = 'exec env -i "PATH=$PATH" "$@"'
# Places that are writable for all by themselves, where a call could leave something for another to read.
_CLOSE = "chmod 0711 /tmp; chmod 0700 /dev/mqueue; "
# What the first process needs to run each call as a user of its own, to look at its memory, and to clear up after it.
POWERS = ("SETUID", "SETGID", "KILL", "CHOWN", "DAC_OVERRIDE", "FOWNER", "SYS_PTRACE")

# As Docker, and Podman, say so.
_NO_IMAGE = ("no such image", "no such object", "image not known")


def run_words(
    name: str,
    image: str,
    environment: Mapping[str, str],
    program: Sequence[str],
    *,
    folder_mb: int,
    folder_files: int,
) -> list[str]:
    """Return the command that runs a program in a container, closed off from all else; the image is never pulled.

    Args:
        name: Of the container.
        image: Of the container.
        environment: All that the program finds, besides the image's search path.
        program: With its arguments.
        folder_mb: Size of ``/tmp``, the only place to write, in megabytes.
        folder_files: Limit of the files and folders in it.
    """
    words = [*_client(), "run", "--rm", "--interactive", "--pull", "never", "--name", name, "--label", LABEL]
    # No log: the engine would keep all that passes between the container and this process on its disk.
    words += ["--network", "none", "--ipc", "none", "--read-only", "--log-driver", "none", "--cap-drop", "ALL"]
    words += ["--security-opt", "no-new-privileges", "--pids-limit", "1024", "--ulimit", "core=0"]
    words += ["--memory", _MEMORY, "--memory-swap", _MEMORY, "--workdir", "/", "--hostname", "sandbox"]
    words += ["--user", "0:0", *(word for power in POWERS for word in ("--cap-add", power))]
    words += ["--tmpfs", f"/tmp:rw,exec,nosuid,nodev,mode=1777,size={folder_mb}m,nr_inodes={folder_files}"]
    words += ["--entrypoint", "/bin/sh", image, "-c", _CLOSE + _START, "sh"]
    return [*words, *(f"{name}={value}" for name, value in environment.items()), *program]


def new_name() -> str:
    """Return a name for a container that no other has."""
    return f"gem-python-{secrets.token_hex(8)}"


def check(image: str) -> None:
    """Make sure that an engine answers and has an image; remove containers that were made long ago and never ran.

    Raises:
        Unavailable: It does not answer, or has no such image; the message says what to do.
    """
    if shutil.which("docker") is None:
        raise Unavailable("the command 'docker' is not on the PATH: install Docker's client and start an engine")
    try:
        find_engine()
        done = _ask("image", "inspect", "--format", "{{.Id}}", image)
    except (MissingRequirementError, OSError, subprocess.TimeoutExpired) as error:
        raise Unavailable(f"the container engine does not answer: {error}") from error
    if done.returncode:
        words = " ".join(done.stderr.split())[:300]
        if any(said in words.lower() for said in _NO_IMAGE):
            raise Unavailable(f"the image {image!r} is not there: 'docker pull {image}', or name another ({words})")
        raise Unavailable(f"the container engine does not answer: start it, or set DOCKER_HOST ({words})")
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        _ask("container", "prune", "--force", "--filter", f"label={LABEL}", "--filter", f"until={_LEFT_FOR}")


def remove(name: str) -> None:
    """Remove a container at once, whatever runs in it; one that is gone already is no failure."""
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        _ask("rm", "--force", "--volumes", name)


def _client() -> list[str]:
    """Return the command of Docker's client, which looks for no engine at Podman's sockets by itself."""
    try:
        place = find_engine()
    except MissingRequirementError:
        return ["docker"]  # whose own error is told
    return ["docker", "--host", place.url] if place.source == "usual place" else ["docker"]


def _ask(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*_client(), *words],
        capture_output=True,
        stdin=subprocess.DEVNULL,
        timeout=_ANSWER_S,
        check=False,
        encoding="utf-8",
        errors="replace",
    )
