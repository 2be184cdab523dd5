"""Runs code in the process that was forked for it, and says what became of it.

What this module reports comes from the same process as the code, which can therefore forge it: a last value, an error's
text. Whether the process ended, how, when and at what cost is told by its keeper alone.
"""

from __future__ import annotations

import ast
import atexit
import base64
import builtins
import contextlib
import gc
import io
import json
import linecache
import os
import random
import signal
import sys
import threading
import traceback
import types
from typing import Any

FILENAME = "<python>"
_MAX_FRAMES = 30
NAMED_INPUT = ".stdin"
"""File in the folder of a call to which ``/dev/stdin`` leads where there is no ``/proc``."""


def make_streams() -> None:
    """Make the three streams anew, ahead of all forks: what is behind their descriptors may change until they are used.

    While they are made, the outputs must be pipes, as they will be: streams remember whether they can seek.
    """
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.dup2(writing, 2)
    sys.stdin = _input(open(0, "rb", closefd=False))  # noqa: SIM115
    sys.stdout = _output(1, "<stdout>", line_buffering=False)
    sys.stderr = _output(2, "<stderr>", line_buffering=True)
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr  # type: ignore[misc]
    os.dup2(0, 1)
    os.dup2(0, 2)
    os.close(reading)
    os.close(writing)


def prepare(stdin: str, files: dict[str, str], *, named: bool) -> None:
    """Set up what a program finds at its start: its folder with its files, and its standard input.

    Args:
        stdin: What it holds.
        files: Content by path, in base 64.
        named: Whether it lies in the folder too.
    """
    write_files(files)
    read_from(stdin)
    if named:
        name_input(stdin)


def prepare_again(stdin: str, files: dict[str, str], *, named: bool) -> None:
    """Put files and standard input in place for a later call of a session, whose variables and streams stay."""
    write_files(files)
    if named:
        name_input(stdin)
    if stdin:
        memory = open(os.open("stdin", os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600), "w+b")  # noqa: SIM115 - becomes stdin
        os.unlink("stdin")
        memory.write(stdin.encode("utf-8", "surrogateescape"))
        memory.seek(0)
        sys.stdin = _input(memory)


def write_files(files: dict[str, str]) -> None:
    """Write files into the current folder."""
    for name, content in files.items():
        folder = os.path.dirname(name)
        if folder:
            os.makedirs(folder, exist_ok=True)
        with open(name, "wb") as stream:
            stream.write(base64.b64decode(content))


def read_from(stdin: str) -> None:
    """Let standard input hold a text."""
    if stdin:
        memory = os.memfd_create("stdin", os.MFD_CLOEXEC)
        content = memoryview(stdin.encode("utf-8", "surrogateescape"))
        while content:
            content = content[os.write(memory, content) :]
        os.lseek(memory, 0, os.SEEK_SET)
    else:
        memory = os.open(os.devnull, os.O_RDONLY)
    os.dup2(memory, 0)
    os.close(memory)


def name_input(stdin: str) -> None:
    """Write standard input into the folder, for code that opens it by name; what does not fit there has no name."""
    try:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(NAMED_INPUT)
        with open(NAMED_INPUT, "xb") as stream:
            stream.write(stdin.encode("utf-8", "surrogateescape"))
    except OSError:
        # Half an input would be worse than none.
        with contextlib.suppress(OSError):
            os.unlink(NAMED_INPUT)


def _input(buffer: io.BufferedReader | io.BufferedRandom) -> io.TextIOWrapper:
    return _named(io.TextIOWrapper(buffer, encoding="utf-8", errors="surrogateescape"), "<stdin>", "r")


def _output(descriptor: int, name: str, *, line_buffering: bool) -> io.TextIOWrapper:
    raw = open(descriptor, "wb", closefd=False)  # noqa: SIM115 - it stays open as long as the process
    stream = io.TextIOWrapper(raw, encoding="utf-8", errors="backslashreplace", line_buffering=line_buffering)
    return _named(stream, name, "w")


def _named(stream: io.TextIOWrapper, name: str, mode: str) -> io.TextIOWrapper:
    """Give a stream what an interpreter gives its own; the fast input of many contestants asks for the mode."""
    stream.buffer.raw.name = name  # type: ignore[attr-defined]
    stream.mode = mode  # type: ignore[misc]
    return stream


class Program:
    """Code that runs as ``__main__``, at once or piece by piece with its variables kept."""

    def __init__(self) -> None:
        module = types.ModuleType("__main__")
        module.__dict__["__builtins__"] = builtins
        self.names = module.__dict__
        sys.modules["__main__"] = module
        sys.argv = [FILENAME]
        self._pid = os.getpid()

    def run(self, code: str, *, wants_value: bool, most: int) -> dict[str, Any]:
        """Run a piece of code.

        Args:
            code: The source.
            wants_value: Whether the value of a last expression is asked for.
            most: Characters of it, of the traceback and of the error that are kept, each.

        Returns:
            ``kind`` ("ok", "error", "exit"), ``code`` for an exit, ``value``, ``error``, ``error_type``, ``traceback``.
        """
        outcome: dict[str, Any] = {"kind": "ok", "code": 0}
        try:
            value = self._executed(code, wants_value)
            if value is not None:
                # A representation runs code as well.
                outcome["value"], outcome["value_chars"] = _shortened(repr(value), most)
        except SystemExit as ending:
            outcome = {"kind": "exit", "code": _exit_code(ending.code)}
            if isinstance(ending.code, str):
                outcome["error"] = ending.code[:most]
        except BaseException as error:  # noqa: BLE001 - code may raise anything, and all of it is told
            outcome = _described(error, most)
            outcome["code"] = 1
        if os.getpid() != self._pid:
            # A process that the code forked came here too: it ends quietly, as at the end of its script.
            self.end()
            os._exit(outcome["code"])
        return outcome

    def _executed(self, code: str, wants_value: bool) -> Any:
        linecache.cache[FILENAME] = (len(code), None, code.splitlines(keepends=True), FILENAME)
        if not wants_value:
            exec(compile(code, FILENAME, "exec", dont_inherit=True), self.names)
            return None
        tree = ast.parse(code, FILENAME)
        last = tree.body[-1] if tree.body else None
        if not isinstance(last, ast.Expr):
            exec(compile(tree, FILENAME, "exec", dont_inherit=True), self.names)
            return None
        tree.body.pop()
        exec(compile(tree, FILENAME, "exec", dont_inherit=True), self.names)
        expression = compile(ast.Expression(last.value), FILENAME, "eval", dont_inherit=True)
        return eval(expression, self.names)

    def end(self) -> None:
        """Do what the interpreter does at the end of a script: wait for threads, run handlers, write out."""
        with contextlib.suppress(BaseException):
            threading._shutdown()  # type: ignore[attr-defined]
        with contextlib.suppress(BaseException):
            atexit._run_exitfuncs()
        flush()


def flush() -> None:
    """Write out what the streams still hold."""
    for stream in (sys.stdout, sys.stderr, sys.__stdout__, sys.__stderr__):
        with contextlib.suppress(BaseException):
            stream.flush()  # type: ignore[union-attr]


def usual_signals() -> None:
    """Answer signals as an interpreter does that has just started."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def as_new() -> None:
    """Make a forked interpreter look like one that has just started."""
    gc.enable()
    random.seed()  # noqa: TID251 - each process draws its own numbers, as if it had just started
    if "numpy.random" in sys.modules:
        sys.modules["numpy.random"].seed()


def _exit_code(code: object) -> int:
    if code is None:
        return 0
    return code & 0xFF if isinstance(code, int) else 1


def _described(error: BaseException, most: int) -> dict[str, Any]:
    kind = type(error).__name__
    try:
        error.__traceback__ = _own_frames(error.__traceback__)
        told = traceback.TracebackException.from_exception(error, limit=-_MAX_FRAMES, compact=True)
        last = "".join(told.format_exception_only()).strip().splitlines()
        whole = "".join(told.format())
    except BaseException:  # noqa: BLE001 - an exception's own methods may fail in any way
        last, whole = [], f"{kind}: an error that cannot be shown\n"
    return {
        "kind": "error",
        "error_type": kind,
        "error": _shortened(last[-1] if last else kind, most)[0],
        "traceback": _shortened(whole, most)[0],
    }


def _own_frames(frames: types.TracebackType | None) -> types.TracebackType | None:
    """Leave out the frames of this module, which run the code."""
    first = frames
    while first is not None and first.tb_frame.f_code.co_filename != FILENAME:
        first = first.tb_next
    return first


def _shortened(text: str, most: int) -> tuple[str, int]:
    if len(text) <= most:
        return text, len(text)
    head = most // 2
    return f"{text[:head]}\n[… {len(text) - most} characters left out …]\n{text[len(text) - (most - head) :]}", len(
        text
    )


def as_json(outcome: dict[str, Any]) -> bytes:
    """Return an outcome as bytes; lone surrogates stay readable."""
    return json.dumps(outcome).encode("ascii")
