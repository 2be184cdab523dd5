"""What the checks share: reading what the agent left, and running it, within limits and without rights.

Programs of the agent's run as a user who owns nothing here: what they do cannot reach the checks, their files or the
reward.
"""

import contextlib
import ctypes
import os
import resource
import signal
import stat
import subprocess
import tempfile
import time
import typing

MOST_BYTES = 5_000_000
NOBODY = 65534
AS_NOBODY = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.getuid() == 0 else {}  # as in a container
NO_NEW_PRIVILEGES = 38  # PR_SET_NO_NEW_PRIVS, prctl(2): no program makes a user another, whatever its permissions


class Done(typing.NamedTuple):
    """What a command did: ``exit_code``, None when it was stopped; ``out`` and ``errors`` as text."""

    exit_code: int | None
    out: str
    errors: str


def read_bytes(path):
    """Return the content of a regular file; a pipe, a device or a giant is refused, and waited for by nobody."""
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with open(number, "rb") as file:
        status = os.fstat(number)
        assert stat.S_ISREG(status.st_mode), f"{path} is not a regular file"
        assert status.st_size <= MOST_BYTES, f"{path} has {status.st_size} bytes"
        return file.read(MOST_BYTES + 1)


def read_text(path):
    """Return the content of a file as text."""
    return read_bytes(path).decode("utf-8")


def files_below(folder):
    """Return the paths of all that is below a folder but folders, relative to it, in order."""
    found = []
    for here, _, names in os.walk(folder):
        found += [os.path.relpath(os.path.join(here, name), folder) for name in names]
        assert len(found) < 10_000, f"{folder} has too many files"
    return sorted(found)


def give(folder):
    """Let the programs that are run write in a folder, and in all that is in it."""
    for here, folders, names in os.walk(folder):
        for path in [here, *(os.path.join(here, name) for name in folders + names)]:
            os.chown(path, NOBODY, NOBODY, follow_symlinks=False)


def _limit():
    ctypes.CDLL(None).prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))


@contextlib.contextmanager
def started(*command, cwd=None, out=subprocess.DEVNULL, errors=subprocess.DEVNULL):
    """Start what the agent wrote, without input; its group is killed at the end."""
    process = subprocess.Popen(
        command,
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        stdout=out,
        stderr=errors,
        start_new_session=True,
        preexec_fn=_limit,
        **AS_NOBODY,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def run(*command, cwd=None, timeout_s=15):
    """Run what the agent wrote, and wait for it."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        with started(*command, cwd=cwd, out=out, errors=errors) as process:
            try:
                exit_code = process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                exit_code = None
        texts = [os.pread(file.fileno(), MOST_BYTES, 0).decode("utf-8", "replace") for file in (out, errors)]
        return Done(exit_code, *texts)


def wait_for(condition, timeout_s=10):
    """Return as soon as a condition holds; False when it does not in that time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
