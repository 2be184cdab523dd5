"""Run a function in another Python process, which may hang or die without harm.

This module imports the standard library only, so that a check of what a plugin imports does not find it imported.
"""

from __future__ import annotations

import faulthandler
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.testing.elsewhere import serve; serve(sys.argv[2])"
)
_NONE: Mapping[str, str] = MappingProxyType({})
_START_S = 300.0
"""Seconds in which the process has to import the function, until that sets a limit of its own."""


class Outcome(NamedTuple):
    """The result of a function that ran in another process.

    Args:
        messages: Pairs that the function sent.
        problem: How the function or its process ended; ``""`` if it returned.
        printed: What the process wrote to standard output.
    """

    messages: list[tuple[str, Any]]
    problem: str
    printed: str


class Sender:
    """Sends pairs of a word and plain data to the process that waits, and limits how long the next step may take."""

    def __init__(self, path: Path) -> None:
        # Files and not pipes: what the process starts may outlive it, and would keep a pipe open.
        self._file = path.open("ab", buffering=0)

    def __call__(self, what: str, value: Any) -> None:
        """Send a pair."""
        self._file.write(json.dumps([what, value]).encode() + b"\n")

    def allow(self, limit_s: float) -> None:
        """End this process, with a traceback on standard error, unless called again within ``limit_s`` seconds."""
        self("limit", limit_s)
        faulthandler.dump_traceback_later(limit_s, exit=True)


def run_elsewhere(function: Callable[..., None], *args: Any, variables: Mapping[str, str] = _NONE) -> Outcome:
    """Call ``function(send, *args)`` in another process, and wait for its end.

    The process has the ``sys.path`` of this one and another hash seed. It leads a session of its own: Ctrl-C in a
    terminal does not reach it, and what it starts is killed with it.

    Args:
        function: A function of a module that can be imported there; its first argument is a ``Sender``.
        *args: Its further arguments, which are pickled.
        variables: Environment variables over those of this process.
    """
    hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    path = json.dumps([entry or os.getcwd() for entry in sys.path])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "request").write_bytes(pickle.dumps((function, args)))
        with (folder / "printed").open("wb") as stdout, (folder / "complained").open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, "-u", "-c", _START, path, name],
                env={**os.environ, "PYTHONHASHSEED": hash_seed, **variables},
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                start_new_session=True,
            )
            try:
                exit_code = process.wait()
            finally:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        answers = folder / "answers"
        sent = [json.loads(line) for line in answers.read_text().splitlines()] if answers.exists() else []
        complained = (folder / "complained").read_text(errors="replace")
        printed = (folder / "printed").read_text(errors="replace")
    messages = [(what, value) for what, value in sent if what not in ("limit", "raised", "returned")]
    return Outcome(messages, _problem(sent, exit_code, complained.strip().splitlines()), printed)


def _problem(sent: list[Any], exit_code: int, complained: list[str]) -> str:
    """Return how the process ended, if its function did not return."""
    last = sent[-1] if sent else ("", "")
    if last[0] == "returned":
        return ""
    if last[0] == "raised":
        return f"it raised {last[1]}"
    if any(line.startswith("Timeout (") for line in complained):  # as ``faulthandler`` writes
        return f"it gave no answer within {[value for what, value in sent if what == 'limit'][-1]:g} s"
    fatal = next((line for line in complained if line.startswith("Fatal Python error: ")), "")
    line = fatal or (complained[-1] if complained else "")
    return f"the process ended with exit code {exit_code}" + (f": {line[:200]}" if line else "")


def serve(name: str) -> None:
    """Call the function that is asked for in a folder."""
    faulthandler.enable()
    folder = Path(name)
    send = Sender(folder / "answers")
    send.allow(_START_S)
    try:
        function, args = pickle.loads((folder / "request").read_bytes())
        function(send, *args)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code; the other side is told
        send("raised", f"{type(error).__name__}: {error}")
    else:
        send("returned", None)
