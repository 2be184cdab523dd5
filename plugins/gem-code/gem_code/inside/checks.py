"""Run the tests of a problem on answers of the program under test; runs inside the sandbox, in a process of its own.

Standard input holds one JSON object: ``prompt``, code that the tests may use, or null; ``entry``, the name of the
function, or null; ``test``, the tests as Python code; ``answers``, what the program has answered so far, by call; and
``explore``, see below. Standard output gets one JSON object: ``units``, one for each test; ``calls``, those to which
there is no answer yet; ``problem``, what is wrong with the tests themselves, or null.

A test is a statement with an assertion, at the top of the tests or of their function ``check``. Each runs whatever
became of those before it. Where a test calls a function of the program, the call is looked up among the answers. One
that is not there is written down, and with ``explore`` the test goes on with a stand-in that agrees to everything, to
find out what else it will call; its verdict is open then, and assertions on stand-ins pass.
"""

from __future__ import annotations

import ast
import builtins
import io
import json
import os
import random
import symtable
import sys
from collections.abc import Iterable
from typing import Any, ClassVar

from gem_code.inside.codec import PLAIN, NotDataError, ProgramError, dumps, loads


def main() -> None:
    """Read the work, do it, and end the process."""
    work = json.load(sys.stdin)
    output = os.dup(1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):
        os.dup2(nowhere, descriptor)
    sys.stdin, sys.stdout = io.StringIO(), os.fdopen(1, "w", encoding="utf-8", errors="replace", closefd=False)
    answers = Answers(work["answers"], explore=work["explore"])
    units = Units(answers)
    try:
        problem = _run(work, answers, units)
    except SyntaxError as error:
        problem = f"they are no Python: {_told(error)}"
    except BaseException as error:  # noqa: BLE001 - tests are data, and may raise anything
        problem = f"they fail outside of any test: {_told(error)}"
    problem = answers.problem or problem
    if StandIn.asked_for and problem is None:
        names = ", ".join(map(repr, sorted(StandIn.asked_for)))
        problem = f"they use {names} of what the program returns, and no plain data has that"
    found = {"units": units.results(), "calls": answers.calls, "problem": problem}
    text = memoryview(json.dumps(found).encode("ascii"))
    while text:
        text = text[os.write(output, text) :]
    os._exit(0)


MAX_AGREED = 5_000
"""How often a stand-in agrees: a test that waits for it to become something else would wait for ever."""


_FILENAME = "<tests>"
_PLAIN_ATTRIBUTES = frozenset(name for kind in PLAIN for name in dir(kind))


class OpenError(BaseException):
    """A test asks what the program has not answered; no ``except Exception`` of a test may hide it."""


class Answers:
    """What the program has answered, looked up by function and arguments; the second equal call gets the second."""

    def __init__(self, given: dict[str, list[str]], *, explore: bool) -> None:
        self.explore = explore
        self.calls: list[list[Any]] = []
        self.problem: str | None = None
        self.open = False  # whether the present test hangs on an answer that is not there yet
        self.failed: str | None = None  # the status of a call to which the program gave no answer at all
        self.call: tuple[str, tuple[Any, ...], dict[str, Any]] | None = None  # the last one of the present test
        self.result: tuple[Any, ...] = ()  # what it returned
        self._given = given
        self._seen: dict[str, int] = {}

    def to(self, name: str, positional: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Return the answer to a call, or raise what the program raised."""
        self.call, self.result = (name, positional, named), ()
        if _has_stand_in(positional) or _has_stand_in(named):
            return self._missing()
        arguments = [list(positional), named]
        try:
            written = dumps(arguments)
        except (NotDataError, RecursionError) as error:
            self.problem = f"they call {name!r} with {error}, which cannot be passed to the program"
            return self._missing()
        key = f"{name} {written}"
        number = self._seen.get(key, 0)
        self._seen[key] = number + 1
        given = self._given.get(key, [])
        if number >= len(given):
            self.calls.append([name, json.loads(written), key])
            return self._missing()
        return self._given_back(given[number], arguments)

    def _missing(self) -> Any:
        self.open = True
        if not self.explore:
            raise OpenError
        return StandIn()

    def _given_back(self, line: str, arguments: list[Any]) -> Any:
        if line.startswith("!"):
            self.failed = self.failed or line[1:]
            raise OpenError
        try:
            answer = json.loads(line)
            raised = answer.get("e")
            result = None if raised else loads(json.dumps(answer["r"]))
            after = loads(json.dumps(answer["a"])) if "a" in answer else None
            name, message = map(str, raised or ("", ""))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ProgramError("the program's answer cannot be read") from error
        if raised:
            raise _exception(name, message)
        if after is not None:
            try:
                _take_over(arguments, after)
            except (ValueError, TypeError, LookupError) as error:
                raise ProgramError("the program's answer cannot be read") from error
        self.result = (result,)
        return result

    def begin(self) -> None:
        """Begin a test: nothing is known of it."""
        self.open, self.failed, self.call, self.result = False, None, None, ()

    def described(self) -> dict[str, Any]:
        """Return the last call of the present test, and what it returned, as text."""
        if self.call is None:
            return {"call": None, "returned": None}
        name, positional, named = self.call
        arguments = [*map(_shown, positional), *(f"{key}={_shown(value)}" for key, value in named.items())]
        returned = _shown(self.result[0]) if self.result else None
        return {"call": f"{name}({', '.join(arguments)})"[:10_000], "returned": returned}


class Function:
    """Stands for a function of the program in the tests."""

    def __init__(self, name: str, answers: Answers) -> None:
        self.__name__ = self.__qualname__ = name
        self._answers = answers

    def __call__(self, *positional: Any, **named: Any) -> Any:
        """Return the program's answer."""
        return self._answers.to(self.__name__, positional, named)

    def __instancecheck__(self, value: Any) -> bool:
        self._answers.problem = f"they ask for objects of the program's class {self.__name__!r}, and none leave it"
        return False


class StandIn:
    """Stands for an answer that is not known yet; agrees to everything, so that a test goes on to its next call."""

    def __init__(self, *_: Any, **__: Any) -> None:
        """Take anything."""

    def _itself(self, *_: Any, **__: Any) -> Any:
        return self

    agreed = 0
    asked_for: ClassVar[set[str]] = set()
    """Attributes that no answer can have, since none is more than plain data."""

    def _yes(self, *_: Any, **__: Any) -> bool:
        StandIn.agreed += 1
        if StandIn.agreed > MAX_AGREED:
            raise OpenError
        return True

    def __hash__(self) -> int:
        return 0

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        # Libraries may look for anything.
        if name not in _PLAIN_ATTRIBUTES and sys._getframe(1).f_code.co_filename == _FILENAME:
            self.asked_for.add(name)
        return self._itself

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Agree; no plain data can be called."""
        self.asked_for.add("__call__")
        return self

    def __iter__(self) -> Any:
        return iter(())

    def __len__(self) -> int:
        return 0

    def __index__(self) -> int:
        return 1

    def __float__(self) -> float:
        return 1.0

    __int__ = __index__
    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __contains__ = __bool__ = _yes
    __getitem__ = __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = _itself
    __truediv__ = __rtruediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = __pow__ = __rpow__ = _itself
    __and__ = __rand__ = __or__ = __ror__ = __xor__ = __rxor__ = __neg__ = __abs__ = __round__ = _itself
    __enter__ = _itself


class Agreeing(ast.NodeTransformer):
    """Lets assertions on stand-ins pass, so that a loop over many makes all its calls."""

    def visit_Assert(self, node: ast.Assert) -> ast.Try:
        """Return the assertion in a guard that drops its failure while the verdict is open anyway."""
        is_open = ast.Call(ast.Name("__gem_open__", ast.Load()), [], [])
        handler = ast.If(is_open, [ast.Pass()], [ast.Raise()])
        return ast.Try([node], [ast.ExceptHandler(ast.Name("Exception", ast.Load()), None, [handler])], [], [])


class Units:
    """The tests, and what became of each; the code of the tests reports here."""

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._results: dict[int, dict[str, Any]] = {}
        self.described: dict[int, tuple[bool, bool]] = {}

    def results(self) -> list[dict[str, Any]]:
        """Return those that count, in order: tests, and preparations that failed."""
        return [result for _, result in sorted(self._results.items())]

    def unit(self, number: int) -> _Unit:
        """Return the guard around a statement."""
        return _Unit(self, number)

    def entered(self) -> None:
        """Begin a statement: nothing is known of it."""
        StandIn.agreed = 0
        self._answers.begin()

    def left(self, number: int, error: BaseException | None) -> None:
        """Note how a statement ended."""
        asserts, may_count = self.described[number]
        is_test = asserts or (may_count and self._answers.call is not None)
        if self._answers.failed is not None:
            status, told = self._answers.failed, None
        elif self._answers.open:
            status, told = "open", None
        elif error is None:
            status, told = "passed", None
        elif isinstance(error, SystemExit):
            # As unittest.main() does, which finds no tests here; the program's own exit comes as another error.
            self._answers.problem = "they end their process, and are to assert something"
            return
        else:
            status = "wrong_answer" if isinstance(error, AssertionError) else "runtime_error"
            told = _told(error)
        if not is_test and status == "passed":
            return
        before = self._results.get(number)
        if before is None or before["status"] == "passed":
            shown = {} if status == "passed" else self._answers.described()
            self._results[number] = {"status": status, "error": told, **shown}


class _Unit:
    def __init__(self, units: Units, number: int) -> None:
        self._units, self._number = units, number

    def __enter__(self) -> None:
        self._units.entered()

    def __exit__(self, kind: Any, error: BaseException | None, _: Any) -> bool:
        self._units.left(self._number, error)
        # Whatever became of it, the next one is tried.
        return True


def _run(work: dict[str, Any], answers: Answers, units: Units) -> str | None:
    """Run the tests; return what is wrong with them, or None."""
    random.seed(0)  # noqa: TID251 - the process is theirs alone, and they are to make the same calls in each run
    tree = ast.parse(work["test"], _FILENAME)
    space: dict[str, Any] = {"__name__": "tests"}
    bound = _prelude(work["prompt"], work["entry"], space)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef) and _is_test(node)]
    checks = any(node.name == "check" for node in functions)
    if checks and not work["entry"]:
        return "they define check(candidate), and the row names no function in 'entry_point'"
    for name in _asked_of_the_program(tree, work["test"], work["entry"], bound):
        # What check(candidate) calls max is Python's: it has another name for that of the program.
        if not (checks and hasattr(builtins, name)):
            space[name] = Function(name, answers)
    for holder in functions or [tree]:
        _guard(holder, units)
    if answers.explore:
        tree = Agreeing().visit(tree)
    space["__gem_unit__"] = units.unit
    space["__gem_open__"] = lambda: answers.open
    exec(compile(ast.fix_missing_locations(tree), _FILENAME, "exec"), space)
    for node in functions:
        arguments = [Function(work["entry"], answers)] if node.name == "check" else []
        space[node.name](*arguments)
    return None if units.results() else "they assert nothing"


def _is_test(node: ast.FunctionDef) -> bool:
    """Tell ``check(candidate)`` and pytest's ``test_…()`` from helpers."""
    count = len(node.args.args)
    return (node.name == "check" and count == 1) or (node.name.startswith("test") and count == 0)


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


def _asked_of_the_program(tree: ast.Module, source: str, entry: str | None, bound: set[str]) -> set[str]:
    """Return the names that the tests use and nobody defines.

    Where there are none, and all that is called bears the name of a function of Python's own, such a function is what
    is tested; else it judges what is tested, and no program may put its own in the place.
    """
    used, defined = _global_names(symtable.symtable(source, _FILENAME, "exec"))
    own = set(dir(builtins))
    asked = used - defined - bound - own
    if asked or entry:
        return asked | ({entry} if entry else set())
    helpers = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    tests = [node for node in tree.body if isinstance(node, ast.FunctionDef) and _is_test(node)]
    bodies = [*tests, *(node for node in tree.body if not isinstance(node, helpers))]
    nodes = [node for body in bodies for node in ast.walk(body)]
    asserted = [node.test for node in nodes if isinstance(node, ast.Assert)]
    handed_over = [node for node in nodes if isinstance(node, ast.Call) and _called(node) in defined | bound]
    kinds = {kind.__name__ for kind in PLAIN} - defined - bound
    tested = own - kinds - defined - bound
    # What makes a value, as list, is what is tested only where nothing else can be.
    return (
        _innermost([*asserted, *handed_over], tested)
        or _innermost(bodies, tested)
        or _innermost([*asserted, *handed_over], kinds)
    )


def _global_names(table: symtable.SymbolTable) -> tuple[set[str], set[str]]:
    """Return the names of the module that code uses, and those that it defines; those of its functions are others."""
    used: set[str] = set()
    defined: set[str] = set()
    for symbol in table.get_symbols():
        if table.get_type() == "module" or symbol.is_global():
            if symbol.is_assigned() or symbol.is_imported() or symbol.is_namespace():
                defined.add(symbol.get_name())
            elif symbol.is_referenced():
                used.add(symbol.get_name())
    for child in table.get_children():
        more = _global_names(child)
        used, defined = used | more[0], defined | more[1]
    return used, defined


def _called(node: ast.Call) -> str | None:
    return node.func.id if isinstance(node.func, ast.Name) else None


def _innermost(places: Iterable[ast.AST], names: set[str]) -> set[str]:
    """Return those of some names that are called, and in whose arguments none of them is."""
    calls = [
        node for place in places for node in ast.walk(place) if isinstance(node, ast.Call) and _called(node) in names
    ]
    inner = {id(call) for call in calls}
    return {
        str(_called(call))
        for call in calls
        if not any(id(node) in inner for node in ast.walk(call) if node is not call)
    }


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


def _has_stand_in(value: Any, depth: int = 0) -> bool:
    if isinstance(value, StandIn):
        return True
    if isinstance(value, dict):
        return any(_has_stand_in(item, depth + 1) for item in value.values()) if depth < 5 else False
    if isinstance(value, list | tuple | set | frozenset):
        return any(_has_stand_in(item, depth + 1) for item in value) if depth < 5 else False
    return False


def _take_over(arguments: list[Any], after: Any) -> None:
    """Change the arguments of a call as the program has changed its copies of them."""
    positional, named = after
    for mine, theirs in (*zip(arguments[0], positional, strict=True), *((arguments[1][k], named[k]) for k in named)):
        if type(mine) is not type(theirs):
            continue
        if isinstance(mine, list | bytearray):
            mine[:] = theirs
        elif isinstance(mine, dict | set):
            mine.clear()
            mine.update(theirs)
        elif hasattr(mine, "extend") and hasattr(mine, "clear"):
            mine.clear()
            mine.extend(theirs)


def _exception(name: str, message: str) -> Exception:
    """Return the exception that the program raised, if Python has it; the message begins with its name."""
    kind = getattr(builtins, name, None)
    text = message.removeprefix(f"{name}: ") if message != name else ""
    if not isinstance(kind, type) or not issubclass(kind, Exception):
        return ProgramError(message)
    try:
        return kind(text)
    except TypeError:  # one that takes more than a text
        return ProgramError(message)


def _shown(value: Any) -> str:
    try:
        return repr(value)[:10_000]
    except ValueError:  # a whole number of more digits than Python writes
        return "a very large number"


def _told(error: BaseException) -> str:
    text = str(error)[:500]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
