"""Run the tests of a problem, which call a program in another process; runs inside the sandbox.

The process is forked before it reads the tests, so that the program's half never holds them; then it makes itself
impossible to look into. Standard input holds one JSON object: ``code``, the program; ``prompt``, what it continues, or
null; ``entry``, the name of its function, or null; ``test``, the tests as Python code; ``wall_s``, the seconds that all
calls together may take; ``spare_mb``, how much less memory the program gets than this process. Standard output gets one
JSON object: ``units``, one for each test, and ``problem``, what is wrong with the tests themselves, or null.

A test is a statement with an assertion, at the top of the tests or of their function ``check``. Each runs whatever
became of those before it.
"""

from __future__ import annotations

import ast
import builtins
import ctypes
import json
import os
import random
import resource
import signal
import socket
import sys
from collections.abc import Callable
from typing import Any

from gem_code.inside.codec import NotDataError, ProgramError
from gem_code.inside.names import asked_of_the_program, from_library, global_names, is_test
from gem_code.inside.pipe import EndedError, Pipe, Target, told
from gem_code.inside.solution import OPERATIONS, Objects, leave_streams

_PR_SET_DUMPABLE = 4
_FILENAME = "<tests>"


def run_tests() -> None:
    """Read the work, do it, and end the process."""
    ours, theirs = socket.socketpair()
    pid = os.fork()
    if pid == 0:
        be_program(theirs)
    theirs.close()
    ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)
    # The program may send any signal; SIGKILL ends the run without a verdict, which is then the program's fault.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)
    work = json.load(sys.stdin)
    output = os.dup(1)
    leave_streams()
    # The program may write modules into its folder; the tests import none of them.
    sys.path[:] = [place for place in sys.path if place not in ("", os.getcwd())]
    program = TestedProgram(ours, pid, work)
    units = Units(program)
    try:
        problem = _run(work, program, units)
    except BaseException as error:  # noqa: BLE001 - tests are data, and may raise anything
        problem = None
        if program.asked:
            units.failed_outside(error)  # on what the program has answered
        elif isinstance(error, SyntaxError):
            problem = f"they are no Python: {told(error)}"
        else:
            problem = f"they fail outside of any test: {told(error)}"
    text = memoryview(json.dumps({"units": units.results(), "problem": program.problem or problem}).encode("ascii"))
    while text:
        text = text[os.write(output, text) :]
    os._exit(0)


def be_program(channel: socket.socket) -> None:
    """Run the program that the tests' process names, and answer until that has ended. Never returns."""
    leave_streams()
    kept = channel.fileno()
    os.closerange(3, kept)
    os.closerange(kept + 1, 1024)
    objects = Objects()
    objects.pipe = pipe = Pipe(channel, objects)
    first = pipe.receive()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        least = max(0, hard - (first["spare_mb"] << 20))
        resource.setrlimit(resource.RLIMIT_AS, (min(soft, least), least))
    pipe.send(objects.load(first["code"], first["prompt"], first["entry"]))
    if objects.module is not None:
        pipe.serve()
    os._exit(0)


class TestedProgram:
    """The program, as its tests see it.

    Args:
        channel: To its process.
        pid: That process.
        work: What this process was given.
    """

    def __init__(self, channel: socket.socket, pid: int, work: dict[str, Any]) -> None:
        self.pipe = Pipe(channel, self)
        self.pipe.left_s = work["wall_s"]
        self.problem: str | None = None
        self.asked = False  # for anything: from then on, what goes wrong with the tests may be its doing
        self.ended: tuple[str, str | None] | None = None  # the status of a program that is gone, and its error
        self.call: tuple[str, tuple[Any, ...], dict[str, Any]] | None = None  # the last one of the present test
        self.result: tuple[Any, ...] = ()  # what it returned
        self._pid = pid
        self._expects_stop = "StopIteration" in work["test"]
        self._given: list[Callable[..., Any]] = []
        self.pipe.send({name: work[name] for name in ("code", "prompt", "entry", "spare_mb")})
        try:
            loaded = self.pipe.receive()
        except EndedError as error:
            reason = "the program ended before its function was called"
            self.end(str(error), None if str(error) == "timeout" else reason)
        except ProgramError as error:
            self.end("runtime_error", str(error))
        else:
            if loaded.get("failed") is not None:
                failed = str(loaded["failed"])
                known = failed in ("compile_error", "memory")
                self.end(failed if known else "runtime_error", str(loaded.get("error")))

    def end(self, status: str, error: str | None) -> None:
        """Note why the program gives no more answers, and kill it."""
        self.ended = (status, error)
        os.kill(self._pid, signal.SIGKILL)

    def ask(self, do: str, of: Target, *positional: Any, **named: Any) -> Any:
        """Have the program do something with what it holds.

        Raises:
            EndedError: It gives no more answers.
            Exception: What it raised.
        """
        self.asked = True
        if do == "__call__":
            self.call, self.result = (of.get("n") or of["h"][1], positional, named), ()
        if self.ended is not None:
            raise EndedError(self.ended[0])
        try:
            result = self.pipe.ask(do, of, *positional, **named)
        except EndedError as error:
            self.end(str(error), None)
            raise
        except StopIteration as error:
            if do == "__next__" or self._expects_stop:
                raise
            # As Python does in generators: `all(map(f, inputs))` would end there, and be true.
            raise RuntimeError("the program raised StopIteration") from error
        if do == "__call__":
            self.result = (result,)
        return result

    def described(self) -> dict[str, Any]:
        """Return the last call of the present test, and what it returned, as text."""
        if self.call is None:
            return {"call": None, "returned": None}
        name, positional, named = self.call
        arguments = [*map(_shown, positional), *(f"{key}={_shown(value)}" for key, value in named.items())]
        returned = _shown(self.result[0]) if self.result else None
        return {"call": f"{name}({', '.join(arguments)})"[:10_000], "returned": returned}

    def hand_over(self, value: Any) -> Target:
        """Return what stands for a function of the tests, or for what is the program's own."""
        if isinstance(value, Remote):
            return value._target
        if not callable(value):
            self.problem = f"they call the program with a value of type {type(value).__name__}, which cannot be passed"
            raise NotDataError(f"a value of type {type(value).__name__}")
        self._given.append(value)
        return {"k": len(self._given) - 1}

    def taken(self, kind: str, content: Any) -> Any:
        """Return what stands for an object of the program's, or a function that it was given."""
        if kind == "h":
            return Remote(self, {"h": [int(content[0]), str(content[1])]})
        if kind == "k":
            return self._given[content]
        raise ValueError(f"nothing is written as {kind!r}")

    def do(self, what: str, of: Target, positional: list[Any], named: dict[str, Any]) -> Any:
        """Call a function that a test has given to the program, and do nothing else with it."""
        if what != "__call__":
            raise NotDataError("a request for what no test has given")
        return self._given[of["k"]](*positional, **named)


class Remote:
    """Stands for a function or an object of the program's, which stays in its process; all that is done is done there.

    Data never compares equal to it, whatever the object itself says: one that claims to equal everything gains nothing.
    """

    _program: TestedProgram
    _target: Target

    def __init__(self, program: TestedProgram, target: Target) -> None:
        vars(self).update(_program=program, _target=target)

    def __getattr__(self, name: str) -> Any:
        if (
            name.startswith("__")
            and name.endswith("__")
            and name not in ("__name__", "__class__", "__dict__", "__doc__")
        ):
            raise AttributeError(name)  # as libraries look for, which take anything for an array
        return self._program.ask("get", self._target, name)

    def __setattr__(self, name: str, value: Any) -> None:
        self._program.ask("set", self._target, name, value)

    def __mro_entries__(self, bases: tuple[Any, ...]) -> tuple[type, ...]:
        self._program.problem = "they derive a class from one of the program's, whose code runs elsewhere"
        raise TypeError(self._program.problem)

    def __instancecheck__(self, value: Any) -> bool:
        return isinstance(value, Remote) and bool(self._program.ask("isinstance", value._target, self))


# What judges a result: `f(1) == 2`, and `abs(f(1) - 2) < 1e-6` too, or `not set(f(1)) ^ {2}`.
_JUDGING = {f"__{name}__" for name in ("eq", "ne", "lt", "le", "gt", "ge", "sub", "rsub", "mod", "floordiv", "truediv")}
_JUDGING |= {"__and__", "__or__", "__xor__"}


def _operation(name: str) -> Callable[..., Any]:
    def asked(self: Remote, *positional: Any, **named: Any) -> Any:
        if name in _JUDGING and not isinstance(positional[0], Remote):
            if positional[0] is None and name in ("__eq__", "__ne__"):
                return name == "__ne__"
            target = self._target
            kind = target["h"][1] if "h" in target else "function"
            raise ProgramError(f"the program returned a value of type {kind}, which is no plain data")
        if name == "__exit__":
            positional = ()
        return self._program.ask(name, self._target, *positional, **named)

    asked.__name__ = name
    return asked


for _name in OPERATIONS:
    if _name.startswith("__"):
        setattr(Remote, _name, _operation(_name))


class Units:
    """The tests, and what became of each; the code of the tests reports here."""

    def __init__(self, program: TestedProgram) -> None:
        self._program = program
        self._results: dict[int, dict[str, Any]] = {}
        self._reported = False
        self.described: dict[int, tuple[bool, bool]] = {}

    def results(self) -> list[dict[str, Any]]:
        """Return those that count, in order: tests, and preparations that failed."""
        return [result for _, result in sorted(self._results.items())]

    def unit(self, number: int) -> _Unit:
        """Return the guard around a statement."""
        return _Unit(self, number)

    def entered(self) -> None:
        """Begin a statement: nothing is known of it."""
        self._program.call, self._program.result = None, ()

    def failed_outside(self, error: BaseException) -> None:
        """Note that the tests came to no end, and that none of them counts."""
        self.described, self._results = {0: (True, True)}, {}
        self.left(0, error)

    def left(self, number: int, error: BaseException | None) -> None:
        """Note how a statement ended."""
        program = self._program
        asserts, may_count = self.described[number]
        is_test = asserts or (may_count and program.call is not None)
        # A bare `except:` of a test may have hidden that its call got no answer.
        if isinstance(error, EndedError) or (program.ended is not None and program.call is not None):
            # The first test that gets no answer says why.
            status, told_of = ("not_run", None) if self._reported else program.ended or ("runtime_error", None)
            self._reported = True
        elif error is None:
            status, told_of = "passed", None
        elif isinstance(error, SystemExit) and not (error.code and program.asked):
            # As unittest.main() does, which finds no tests here; the program's own exit comes as another error, and
            # an exit code is what tests say of a wrong answer.
            program.problem = "they end their process, and are to assert something"
            return
        else:
            status = "wrong_answer" if isinstance(error, AssertionError) else "runtime_error"
            told_of = told(error)
        if not is_test and status == "passed":
            return
        before = self._results.get(number)
        if before is None or before["status"] == "passed":
            shown = {} if status == "passed" else program.described()
            self._results[number] = {"status": status, "error": told_of, **shown}


class _Unit:
    def __init__(self, units: Units, number: int) -> None:
        self._units, self._number = units, number

    def __enter__(self) -> None:
        self._units.entered()

    def __exit__(self, kind: Any, error: BaseException | None, _: Any) -> bool:
        self._units.left(self._number, error)
        # Whatever became of it, the next one is tried.
        return True


def _run(work: dict[str, Any], program: TestedProgram, units: Units) -> str | None:
    """Run the tests; return what is wrong with them, or None."""
    random.seed(0)  # noqa: TID251 - the process is theirs alone, and a verdict is to be the same in each run
    tree = ast.parse(work["test"], _FILENAME)
    space: dict[str, Any] = {"__name__": "tests"}
    bound = _prelude(work["prompt"], work["entry"], space)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef) and is_test(node)]
    checks = any(node.name == "check" for node in functions)
    if checks and not work["entry"]:
        return "they define check(candidate), and the row names no function in 'entry_point'"
    used, defined = global_names(work["test"])
    unknown = used - defined - bound
    library = {name: value for name in unknown for value in from_library(name, tree)}
    asked = asked_of_the_program(tree, unknown, set(library) | set(dir(builtins)), work["entry"], work["prompt"])
    space |= {name: value for name, value in library.items() if name not in asked}
    caught = {name.id for node in ast.walk(tree) for name in _caught(node) if name.id in asked}
    for name in asked:
        if name in caught:
            space[name] = program.pipe.exceptions[name] = type(name, (ProgramError,), {})
        # What check(candidate) calls max is Python's: it has another name for that of the program.
        elif not (checks and hasattr(builtins, name)):
            space[name] = Remote(program, {"n": name})
    for holder in functions or [tree]:
        _guard(holder, units)
    space["__gem_unit__"] = units.unit
    exec(compile(ast.fix_missing_locations(tree), _FILENAME, "exec"), space)
    for node in functions:
        arguments = [Remote(program, {"n": work["entry"]})] if node.name == "check" else []
        space[node.name](*arguments)
    return None if units.results() else "they assert nothing"


def _caught(node: ast.AST) -> list[ast.Name]:
    """Return the names of exceptions that a handler, or pytest's ``raises``, waits for."""
    if isinstance(node, ast.ExceptHandler) and node.type is not None:
        return [name for name in ast.walk(node.type) if isinstance(name, ast.Name)]
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ("raises", "assertRaises")
    ):
        return [name for name in node.args if isinstance(name, ast.Name)]
    return []


def _prelude(prompt: str | None, entry: str | None, space: dict[str, Any]) -> set[str]:
    """Run a prompt that is code, for helpers that the tests use; return the names it binds."""
    if not prompt:
        return set()
    try:
        tree = ast.parse(prompt)
    except (SyntaxError, ValueError):
        return set()
    # A word of prose, as "Sort", is an expression of Python too.
    tree.body = [node for node in tree.body if getattr(node, "name", None) != entry and not isinstance(node, ast.Expr)]
    exec(compile(tree, "<prompt>", "exec"), space)
    return set(space)


def _guard(holder: Any, units: Units) -> None:
    """Put each statement of a module or function into a guard of its own."""
    body: list[ast.stmt] = []
    for node in holder.body:
        if isinstance(node, ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal):
            body.append(node)
            continue
        defines = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        # `assert True` tests nothing.
        asserted = (item.test for item in ast.walk(node) if isinstance(item, ast.Assert))
        asserts = not defines and any(not isinstance(test, ast.Constant) for test in asserted)
        may_count = isinstance(node, ast.Expr | ast.For | ast.While | ast.With | ast.Try | ast.If)
        number = len(units.described)
        units.described[number] = (asserts, may_count)
        call = ast.Call(ast.Name("__gem_unit__", ast.Load()), [ast.Constant(number)], [])
        body.append(ast.With([ast.withitem(call)], [node]))
    holder.body = body


def _shown(value: Any) -> str:
    if isinstance(value, Remote):
        target = value._target
        return f"<{target['h'][1]} object>" if "h" in target else str(target["n"])
    try:
        return repr(value)[:10_000]
    except ValueError:  # a whole number of more digits than Python writes
        return "a very large number"
    except BaseException:  # noqa: BLE001 - the program's own __repr__, or its end
        return "an object that cannot be shown"
