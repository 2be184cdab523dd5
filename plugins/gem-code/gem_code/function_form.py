"""Grade functions: the program runs in a process of the sandbox, and what it returns is judged out of its reach.

With given arguments, the results come back as plain data (``gem_code.inside.codec``) and are compared here. With
assertions, the tests run in a process beside that of the program, in the same sandbox, and call it over a pipe
(``gem_code.inside.pipe``). So the program never sees what is expected of it; nothing that it patches, prints or exits
from is there where the verdict is reached; and an object that claims to equal everything equals nothing.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from gem_code.comparing import same_value
from gem_code.inside import program
from gem_code.inside.codec import NotDataError, ProgramError, decode, encode
from gem_code.verdicts import CaseResult, Status, Verdict, status_of
from gem_core.errors import GradingError

if TYPE_CHECKING:
    from gem_code.cases import AssertionTests, CallTests
    from gem_code.program_form import Grading
    from gem_code.runner import Runner
    from gem_tools.python import Outcome

_TIMES = 3
"""How many times the limit of the program's calls a run with tests may take, for what the tests compute themselves."""

_TEST_MB, _TEST_OUTPUT_BYTES = 1024, 64_000_000


async def grade_calls(code: str, tests: CallTests, runner: Runner, grading: Grading) -> Verdict:
    """Return what became of a function that is called with given arguments.

    Raises:
        NoVerdictError: There is no verdict.
        GradingError: An argument cannot be passed to a program.
    """
    try:
        calls = [[encode(arguments), {"d": []}] for arguments in tests.inputs]
    except NotDataError as error:
        raise GradingError(f"the tests have {error} among the arguments") from error
    work = json.dumps({"code": code, "function": tests.function, "calls": calls})
    run = await runner.run(program("solution"), work, grading.limits)
    first, *lines = run.stdout.split("\n")[:-1] or [""]
    failed, why = _load_report(first, run)
    # The call that was under way when the program ended, and those behind it.
    stopped: Status = "runtime_error" if run.status == "ok" else status_of(run)
    # Some rows of APPS and TACO wrap what is expected in a list of one, then in all of their tests.
    wrapped = all(isinstance(expected, list) and len(expected) == 1 for expected in tests.outputs)
    results = []
    for index, (arguments, expected) in enumerate(zip(tests.inputs, tests.outputs, strict=True)):
        returned = reason = None
        if failed is not None:
            status, reason = failed if index == 0 else "not_run", why
        elif index < len(lines):
            status, returned, reason = _judged(lines[index], expected, grading.float_tolerance, wrapped=wrapped)
        else:
            status = stopped if index == len(lines) else "not_run"
        results.append(CaseResult(index, status, reason, repr(arguments)[:10_000], returned))
    return Verdict(_up_to_first_failure(results, grading), run.sandbox)


async def grade_assertions(code: str, tests: AssertionTests, runner: Runner, grading: Grading) -> Verdict:
    """Return what became of a program in tests that call its functions.

    Raises:
        NoVerdictError: There is no verdict.
        GradingError: The tests themselves are at fault; the message says how.
    """
    run, units, problem = await _tested(code, tests, runner, grading)
    if units is not None and not problem:
        return Verdict(_up_to_first_failure(_results(units), grading), run.sandbox)
    # The run ended without a verdict. It is the program's fault if the same tests end well without one: it may have
    # taken memory or files from the process of the tests, which then fails where it would not.
    without, units, problem = await _tested("", tests, runner, grading)
    if units is None:
        why = without.error or without.status
        ended = without.status in ("ok", "exit")
        raise GradingError(
            f"the tests ended without a result: {why}" if ended else f"the tests do not come to their end: {why}"
        )
    if problem:
        raise GradingError(f"the tests are at fault: {problem}")
    status = "runtime_error" if run.status == "ok" else status_of(run)
    error = run.error or "the tests did not get through with its answers"
    later = [CaseResult(index, "not_run") for index in range(1, len(units))]
    return Verdict([CaseResult(0, status, error), *later], run.sandbox)


async def _tested(
    code: str, tests: AssertionTests, runner: Runner, grading: Grading
) -> tuple[Outcome, list[dict[str, Any]] | None, str | None]:
    """Run a program and its tests; return what became of each test, and what seems to be wrong with the tests.

    There are no tests, but None, where the run came to no end.
    """
    limits = grading.limits
    # Tests may hold more data than the program that they test is to hold or print.
    memory, output = max(limits.memory_mb, _TEST_MB), max(limits.output_bytes, _TEST_OUTPUT_BYTES)
    wider = replace(
        limits,
        wall_s=_TIMES * limits.wall_s,
        memory_mb=memory,
        output_bytes=output,
    )
    work = {"code": code, "prompt": tests.prompt, "entry": tests.entry, "test": tests.source}
    more = {"wall_s": limits.wall_s, "spare_mb": memory - limits.memory_mb}
    run = await runner.run(program("checks"), json.dumps({**work, **more}), wider)
    if run.status != "ok":
        return run, None, None
    try:
        found = json.loads(run.stdout)
        return run, found["units"], found["problem"]
    except (ValueError, TypeError, KeyError):
        return run, None, None


def _load_report(line: str, run: Outcome) -> tuple[Status | None, str | None]:
    """Return why the program could not be loaded, or None, and its error."""
    try:
        report = json.loads(line)
        failed = report["failed"]
    except (ValueError, TypeError, KeyError, RecursionError):
        if run.status != "ok":
            return status_of(run), run.error
        return "runtime_error", "the program ended before its function was called"
    if failed not in (None, "compile_error", "memory"):
        failed = "runtime_error"
    return failed, None if failed is None else str(report.get("error"))


def _judged(
    line: str, expected: Any, tolerance: float | None, *, wrapped: bool
) -> tuple[Status, str | None, str | None]:
    """Return the status of a call, what it returned, and its error."""
    try:
        answer = json.loads(line)
        if "r" not in answer:
            error = str(answer["e"][1])
            return "memory" if error.startswith("MemoryError") else "runtime_error", None, error
        returned = decode(answer["r"], _no_data)
        right = same_value(returned, expected, tolerance) or (wrapped and same_value(returned, expected[0], tolerance))
    except ProgramError as error:
        return "runtime_error", None, str(error)
    except (ValueError, TypeError, LookupError, RecursionError):
        return "runtime_error", None, "the program's answer cannot be read"
    return "passed" if right else "wrong_answer", _shown(returned), None


def _no_data(kind: str, content: Any) -> Any:
    if kind != "h":
        raise ValueError(f"nothing is written as {kind!r}")
    raise ProgramError(f"the program returned a value of type {content[1]}, which is no plain data")


def _results(units: list[dict[str, Any]]) -> list[CaseResult]:
    results = []
    for index, unit in enumerate(units):
        status: Status = unit["status"] if unit["status"] in get_args(Status) else "runtime_error"
        error = unit["error"]
        if status == "runtime_error" and str(error).startswith("MemoryError"):
            status = "memory"
        # The test itself and its message say what is expected: the call is shown in their place.
        reason = None if status == "wrong_answer" else error
        results.append(CaseResult(index, status, reason, unit.get("call"), unit.get("returned")))
    return results


def _up_to_first_failure(results: list[CaseResult], grading: Grading) -> list[CaseResult]:
    failed = next((result.index for result in results if result.status != "passed"), len(results))
    if grading.every:
        return results
    return [result if result.index <= failed else CaseResult(result.index, "not_run") for result in results]


def _shown(value: Any) -> str:
    try:
        return repr(value)[:10_000]
    except ValueError:  # a whole number of more digits than Python writes
        return "a very large number"
