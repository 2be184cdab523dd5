"""Grade functions: the program is called in one process of the sandbox, and its answers are judged outside of it.

With assertions, the tests run in another process of the sandbox, which no code of the program ever enters: it gets the
program's answers as plain data (``gem_code.inside.codec``). So the program never sees what is expected of it; nothing
that it patches, prints or exits from is there where the verdict is reached; and an object that claims to equal
everything arrives as what it holds, or not at all. Which calls the tests make is found out by running them without
answers first, which is done once for a row.
"""

from __future__ import annotations

import asyncio
import collections
import json
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_code.comparing import same_value
from gem_code.inside import program
from gem_code.inside.codec import NotDataError, ProgramError, encode, loads
from gem_code.verdicts import CaseResult, Status, Verdict, status_of
from gem_core.errors import GradingError

if TYPE_CHECKING:
    from gem_code.cases import AssertionTests, CallTests
    from gem_code.program_form import Grading
    from gem_code.runner import ProgramLimits, Run, Runner

MAX_ROUNDS = 128
"""How often tests may ask for calls that hang on answers to earlier ones."""

_DOUBTFUL = 3
"""Rounds after which it is looked at whether the tests make the same calls each time."""

_MAX_TIME = 6
"""How many times the limit of one run all runs together may take."""

_KEPT_PLANS = 4096
_TEST_MB, _TEST_OUTPUT_BYTES = 1024, 64_000_000


class Call(NamedTuple):
    """A call of a function of the program: its name, the encoded arguments, and what it is looked up by."""

    name: str
    arguments: Any
    key: str


class Answers(NamedTuple):
    """What a program answered.

    Args:
        lines: One for each call, as written by the program's side; ``!status`` where there is none.
        failed: Why the program could not be loaded; None where it could.
        error: Its exception.
        sandbox: Level of isolation.
    """

    lines: list[str]
    failed: Status | None
    error: str | None
    sandbox: str | None


class Checked(NamedTuple):
    """What a run of the tests found."""

    units: list[dict[str, Any]]
    calls: list[Call]
    explored: bool = False


async def grade_calls(code: str, tests: CallTests, runner: Runner, grading: Grading) -> Verdict:
    """Return what became of a function that is called with given arguments.

    Raises:
        SandboxError: There is no verdict.
        GradingError: An argument cannot be passed to a program.
    """
    try:
        calls = [Call(tests.function, [encode(arguments), {"d": []}], "") for arguments in tests.inputs]
    except NotDataError as error:
        raise GradingError(f"the tests have {error} among the arguments") from error
    answers = await _answers(code, None, None, calls, runner, grading.limits)
    # Some rows of APPS and TACO wrap what is expected in a list of one, then in all of their tests.
    wrapped = all(isinstance(expected, list) and len(expected) == 1 for expected in tests.outputs)
    results = []
    for index, line in enumerate(answers.lines):
        status, returned, reason = _judged(line, tests.outputs[index], grading.float_tolerance, wrapped=wrapped)
        if answers.failed is not None:
            status, reason = answers.failed if index == 0 else "not_run", answers.error
        results.append(CaseResult(index, status, reason, repr(tests.inputs[index])[:10_000], returned))
    return Verdict(_up_to_first_failure(results, grading), answers.sandbox)


async def grade_assertions(code: str, tests: AssertionTests, runner: Runner, grading: Grading) -> Verdict:
    """Return what became of a program in tests that call its functions.

    Raises:
        SandboxError: There is no verdict.
        GradingError: The tests themselves are at fault; the message says how.
    """
    first = await _plan(tests, runner, grading.limits)
    calls, explore = list(first.calls), first.explored
    clock = asyncio.get_running_loop().time
    started = clock()
    rounds = 0
    while True:
        answers = await _answers(code, tests.prompt, tests.entry, calls, runner, grading.limits)
        if answers.failed is not None:
            return _verdict_all(first, answers.failed, answers.error, answers.sandbox)
        by_key: dict[str, list[str]] = {}
        for call, line in zip(calls, answers.lines, strict=True):
            by_key.setdefault(call.key, []).append(line)
        run = await _run_checks(tests, by_key, runner, grading.limits, explore=explore)
        if not run.finished and explore:
            # As with a loop that goes on for as long as a stand-in agrees.
            explore = False
            run = await _run_checks(tests, by_key, runner, grading.limits)
        if not run.finished:
            # Without answers these tests came to their end, so that it is the answers that stop them.
            return _verdict_all(first, status_of(run), "the tests did not get through with its answers", run.sandbox)
        checked = _checked(run)
        if not checked.calls:
            return Verdict(_up_to_first_failure(_results(checked.units), grading), answers.sandbox)
        calls += checked.calls
        rounds += 1
        if rounds == _DOUBTFUL:
            await _check_repeatable(first, tests, runner, grading.limits)
        if rounds == MAX_ROUNDS or clock() - started > _MAX_TIME * grading.limits.wall_s:
            return _verdict_all(first, "timeout", "its answers let the tests ask for ever more", answers.sandbox)


async def _check_repeatable(first: Checked, tests: AssertionTests, runner: Runner, limits: ProgramLimits) -> None:
    """See whether tests that ask for ever more calls begin the same each time; else the fault is their own.

    Raises:
        GradingError: They do not.
    """
    again = _checked(await _run_checks(tests, {}, runner, limits, explore=first.explored))
    if again.calls != first.calls:
        raise GradingError("the tests make other calls in each run; draw their numbers from a generator with a seed")


# The program's side.


async def _answers(
    code: str, prompt: str | None, entry: str | None, calls: Sequence[Call], runner: Runner, limits: ProgramLimits
) -> Answers:
    """Call a program in a fresh process."""
    asked = [[call.name, call.arguments] for call in calls]
    work = json.dumps({"code": code, "prompt": prompt, "entry": entry, "calls": asked})
    run = await runner.run(program("solution"), work, limits)
    first, *lines = run.stdout.split("\n")[:-1] or [""]
    failed, error = _load_report(first, run)
    lines = lines[: len(calls)]
    if len(lines) < len(calls) and failed is None:
        # The call that was under way, and those behind it.
        stopped: Status = "runtime_error" if run.finished else status_of(run)
        lines += [f"!{stopped}"] + ["!not_run"] * (len(calls) - len(lines) - 1)
    lines += ["!not_run"] * (len(calls) - len(lines))
    return Answers(lines, failed, error, run.sandbox)


def _load_report(line: str, run: Run) -> tuple[Status | None, str | None]:
    try:
        report = json.loads(line)
        failed = report["failed"]
    except (ValueError, TypeError, KeyError, RecursionError):
        if not run.finished:
            return status_of(run), run.error
        return "runtime_error", "the program ended before its function was called"
    if failed not in (None, "compile_error", "memory"):
        failed = "runtime_error"
    return failed, None if failed is None else str(report.get("error"))


# The tests' side.

_plans: collections.OrderedDict[AssertionTests, Checked] = collections.OrderedDict()
_plans_lock = threading.Lock()


async def _plan(tests: AssertionTests, runner: Runner, limits: ProgramLimits) -> Checked:
    """Return which tests there are and which calls they make, as far as it can be told without answers.

    Raises:
        GradingError: The tests are at fault.
    """
    with _plans_lock:
        if tests in _plans:
            _plans.move_to_end(tests)
            return _plans[tests]
    explored = True
    run = await _run_checks(tests, {}, runner, limits, explore=True)
    if not run.finished:
        explored = False
        # As with a loop that waits for a stand-in to become something else.
        run = await _run_checks(tests, {}, runner, limits)
    if not run.finished:
        raise GradingError(f"the tests do not come to their end: {run.error or run.status}")
    plan = _checked(run)._replace(explored=explored)
    with _plans_lock:
        _plans[tests] = plan
        while len(_plans) > _KEPT_PLANS:
            _plans.popitem(last=False)
    return plan


async def _run_checks(
    tests: AssertionTests,
    answers: dict[str, list[str]],
    runner: Runner,
    limits: ProgramLimits,
    *,
    explore: bool = False,
) -> Run:
    work = {"prompt": tests.prompt, "entry": tests.entry, "test": tests.source, "answers": answers}
    # Tests may hold more data than the program that they test is to print.
    memory, output = max(limits.memory_mb, _TEST_MB), max(limits.output_bytes, _TEST_OUTPUT_BYTES)
    wider = replace(limits, memory_mb=memory, output_bytes=output)
    return await runner.run(program("checks"), json.dumps({**work, "explore": explore}), wider)


def _checked(run: Run) -> Checked:
    try:
        found = json.loads(run.stdout)
        if found["problem"]:
            raise GradingError(f"the tests are at fault: {found['problem']}")
        return Checked(found["units"], [Call(*call) for call in found["calls"]])
    except (ValueError, TypeError, KeyError) as error:
        raise GradingError(f"the tests ended without a result: {run.error or run.stdout[:200]!r}") from error


# Verdicts.


def _judged(
    line: str, expected: Any, tolerance: float | None, *, wrapped: bool
) -> tuple[Status, str | None, str | None]:
    """Return the status of a call, what it returned, and its error."""
    if line.startswith("!"):
        return _as_status(line[1:]), None, None
    try:
        answer = json.loads(line)
        if "r" not in answer:
            error = str(answer["e"][1])
            return "memory" if error.startswith("MemoryError") else "runtime_error", None, error
        returned = loads(json.dumps(answer["r"]))
        right = same_value(returned, expected, tolerance) or (wrapped and same_value(returned, expected[0], tolerance))
    except ProgramError as error:
        return "runtime_error", None, str(error)
    except (ValueError, TypeError, LookupError, RecursionError):
        return "runtime_error", None, "the program's answer cannot be read"
    return "passed" if right else "wrong_answer", _shown(returned), None


def _results(units: list[dict[str, Any]]) -> list[CaseResult]:
    results = []
    for index, unit in enumerate(units):
        status = _as_status(unit["status"])
        error = unit["error"]
        if status == "runtime_error" and str(error).startswith("MemoryError"):
            status = "memory"
        # The test itself and its message say what is expected: the call is shown in their place.
        reason = None if status == "wrong_answer" else error
        results.append(CaseResult(index, status, reason, unit.get("call"), unit.get("returned")))
    return results


def _verdict_all(plan: Checked, status: Status, error: str | None, sandbox: str | None) -> Verdict:
    """Return the verdict on a program that failed before any test: the first one names the reason."""
    later = [CaseResult(index, "not_run") for index in range(1, max(len(plan.units), 1))]
    return Verdict([CaseResult(0, status, error), *later], sandbox)


def _up_to_first_failure(results: list[CaseResult], grading: Grading) -> list[CaseResult]:
    failed = next((result.index for result in results if result.status != "passed"), len(results))
    if grading.every:
        return results
    return [result if result.index <= failed else CaseResult(result.index, "not_run") for result in results]


def _as_status(text: str) -> Status:
    known: tuple[Status, ...] = ("passed", "wrong_answer", "timeout", "memory", "output_limit", "not_run")
    return next((status for status in known if status == text), "runtime_error")


def _shown(value: Any) -> str:
    try:
        return repr(value)[:10_000]
    except ValueError:  # a whole number of more digits than Python writes
        return "a very large number"
