"""Runs code in the process that was forked for it, and reports its outcome.

What this module reports comes from the same process as the code, which can therefore forge it: a last value, an error's
text. Whether the process ended, how, when and at what cost is told by the first process alone.
"""

from __future__ import annotations

import ast
import atexit
import builtins
import contextlib
import io
import linecache
import os
import sys
import threading
import traceback
import types
from typing import Any

FILENAME = "<python>"
"""Of the code; a later piece of a session has its number in it, so that each keeps its own lines."""

_MAX_FRAMES = 30
_MOST_FRAMES = 2000  # looked at for the last of the code's own; a recursion without an end has millions
_MAX_LINE = 300
_SHELL_MARKS = ("!", "%", ">>>", "pip ")
_PLAIN_PYTHON = (
    "Lines that begin with !, %, >>> or pip are for notebooks and shells: write plain Python instead. Nothing can be "
    "installed, as there is no network."
)
NAMED_INPUT = ".stdin"
"""File in the folder of a call to which ``/dev/stdin`` leads where there is no ``/proc``."""


def make_streams() -> None:
    """Make the three streams as an interpreter does at its start."""
    sys.stdin = sys.__stdin__ = input_stream()  # type: ignore[misc]
    sys.stdout = sys.__stdout__ = _output(1, "<stdout>", line_buffering=False)  # type: ignore[misc]
    sys.stderr = sys.__stderr__ = _output(2, "<stderr>", line_buffering=True)  # type: ignore[misc]


def name_input() -> None:
    """Write standard input into the folder, for code that opens it by name; what does not fit there has no name."""
    try:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(NAMED_INPUT)
        with open(NAMED_INPUT, "xb") as stream:
            place = 0
            while sent := os.sendfile(stream.fileno(), 0, place, 1 << 30):
                place += sent
    except OSError:
        # Half an input would be worse than none.
        with contextlib.suppress(OSError):
            os.unlink(NAMED_INPUT)


def input_stream() -> io.TextIOWrapper:
    """Return standard input as text."""
    raw = open(0, "rb", closefd=False)  # noqa: SIM115 - it stays open as long as the process
    return _named(io.TextIOWrapper(raw, encoding="utf-8", errors="surrogateescape"), "<stdin>", "r")


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
        self._pieces = 0

    def run(self, code: str, *, wants_value: bool, most: int) -> dict[str, Any]:
        """Run a piece of code.

        Args:
            code: The source.
            wants_value: Whether the value of a last expression is asked for; then code is read as a person at a prompt
                means it, too: it may be indented as a whole.
            most: Characters of it, of the tracebacks and of the error that are kept, each.

        Returns:
            ``kind`` ("ok", "error", "exit"), ``code`` for an exit, ``value``, ``error``, ``error_type``, ``traceback``,
            ``short_traceback``.
        """
        outcome: dict[str, Any] = {"kind": "ok", "code": 0}
        self._pieces += 1
        try:
            value = self._executed(code, wants_value)
            if value is not None:
                outcome["value"], outcome["value_chars"] = _shortened(value, most)
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

    def _executed(self, code: str, wants_value: bool) -> str | None:
        filename = FILENAME if self._pieces == 1 else f"<python {self._pieces}>"
        # The lines as Python counts them, and as the module keeps those of files.
        linecache.cache[filename] = (len(code), None, list(io.StringIO(f"{code}\n", newline=None)), filename)
        if not wants_value:
            exec(compile(code, filename, "exec", dont_inherit=True), self.names)
            return None
        tree = _parsed(code, filename)
        last: list[ast.stmt] = [tree.body.pop()] if tree.body and isinstance(tree.body[-1], ast.Expr) else []
        exec(compile(tree, filename, "exec", dont_inherit=True), self.names)
        shown: list[str] = []
        usual = sys.displayhook
        # As at a prompt, so that what a representation raises comes from the line of its expression.
        sys.displayhook = lambda value: None if value is None else shown.append(repr(value))
        try:
            exec(compile(ast.Interactive(last), filename, "single", dont_inherit=True), self.names)
        finally:
            sys.displayhook = usual
        return shown[-1] if shown else None

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


def _exit_code(code: object) -> int:
    if code is None:
        return 0
    return code & 0xFF if isinstance(code, int) else 1


def _parsed(code: str, filename: str) -> ast.Module:
    """Return the tree of some code; what is indented as a whole is the inside of a block."""
    lines = (line for line in io.StringIO(code, newline=None) if not line.lstrip().startswith("#"))
    indented = next(filter(str.strip, lines), "")[:1].isspace()
    try:
        tree = ast.parse(f"if True:\n{code}" if indented else code, filename)
    except SyntaxError as error:
        if indented and error.lineno is not None:
            error.lineno, error.end_lineno = error.lineno - 1, error.lineno - 1
        if (error.text or "").lstrip().startswith(_SHELL_MARKS):
            error.add_note(_PLAIN_PYTHON)
        raise
    if indented:
        tree.body = tree.body[0].body  # type: ignore[attr-defined]
        ast.increment_lineno(tree, -1)
    return tree


def _described(error: BaseException, most: int) -> dict[str, Any]:
    kind = type(error).__name__
    try:
        if isinstance(error, SyntaxError) and error.text is None and error.filename and error.lineno:
            error.text = linecache.getline(error.filename, error.lineno)  # of code that could be parsed
        told = traceback.TracebackException.from_exception(error, limit=-_MOST_FRAMES, compact=True)
        chain = _chain(told)
        for each in chain:
            first = next((place for place, frame in enumerate(each.stack) if _is_own(frame)), 0)
            each.stack = traceback.StackSummary(each.stack[first:][-_MAX_FRAMES:])  # without the frames of this module
        whole = "".join(told.format())
        for each in chain:
            _shorten_stack(each)
        short = "".join(told.format())
        told.__notes__ = None
        last = [*told.format_exception_only()][-1].strip()
    except BaseException:  # noqa: BLE001 - an exception's own methods may fail in any way
        last, whole = kind, f"{kind}: an error that cannot be shown\n"
        short = whole
    return {
        "kind": "error",
        "error_type": kind,
        "error": _shortened(last, most)[0],
        "traceback": _shortened(whole, most)[0],
        "short_traceback": _shortened(short, most)[0],
    }


def _chain(told: traceback.TracebackException) -> list[traceback.TracebackException]:
    """Return what tells of an exception, of its causes, and of those of its group."""
    found: dict[int, traceback.TracebackException] = {}
    waiting: list[traceback.TracebackException | None] = [told]
    while waiting:
        each = waiting.pop()
        if each is not None and id(each) not in found:
            found[id(each)] = each
            waiting += [each.__cause__, each.__context__, *(each.exceptions or ())]
    return list(found.values())


def _is_own(frame: traceback.FrameSummary) -> bool:
    return frame.filename.startswith(FILENAME[:-1])


def _shorten_stack(told: traceback.TracebackException) -> None:
    """Leave the last frame of the code's own, with no more of a long line than its beginning, and no marks below it."""
    own = [frame for frame in told.stack if _is_own(frame)][-1:]
    lines = [(frame.filename, frame.lineno or 0, frame.name, (frame.line or "")[:_MAX_LINE]) for frame in own]
    told.stack = traceback.StackSummary.from_list(lines)
    text = getattr(told, "text", None)
    if text is not None and len(text) > _MAX_LINE:
        told.text, told.offset = text[:_MAX_LINE], None  # type: ignore[assignment]


def _shortened(text: str, most: int) -> tuple[str, int]:
    if len(text) <= most:
        return text, len(text)
    head = most // 2
    return f"{text[:head]}\n[… {len(text) - most} characters left out …]\n{text[len(text) - (most - head) :]}", len(
        text
    )
