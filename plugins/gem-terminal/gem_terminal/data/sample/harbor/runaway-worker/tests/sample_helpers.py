"""What the checks share: reading what the agent left, and running it, within limits."""

import contextlib
import os
import resource
import signal
import stat
import subprocess
import tempfile

MOST_BYTES = 5_000_000


class Done:
    """What a command did: ``exit_code``, None when it was stopped; ``out`` and ``errors`` as text."""

    def __init__(self, exit_code, out, errors):
        self.exit_code = exit_code
        self.out = out
        self.errors = errors


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


def _limit():
    os.setsid()
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))


def run(*command, cwd=None, timeout_s=15, env=None):
    """Run what the agent wrote, without input: its output limited, its group killed when it is over."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command,
            cwd=cwd,
            env=None if env is None else {**os.environ, **env},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=errors,
            preexec_fn=_limit,
        )
        try:
            exit_code = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            exit_code = None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        texts = []
        for file in (out, errors):
            file.seek(0)
            texts.append(file.read(MOST_BYTES).decode("utf-8", "replace"))
        return Done(exit_code, *texts)
