"""Grade a whole program: standard input in, standard output compared here, out of its reach.

What is expected never enters the sandbox. A program may print, exit or break what it likes: it is right if it prints
what is expected and ends in peace.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from gem_code.comparing import same_output
from gem_code.verdicts import CaseResult, Verdict, status_of
from gem_tools.python import Limits

if TYPE_CHECKING:
    from gem_code.cases import StdinTests
    from gem_code.runner import Runner


@dataclass(frozen=True)
class Grading:
    """How tests are run and compared.

    Args:
        limits: Of each run of a program.
        float_tolerance: See ``comparing.same_output``.
        parallel: Runs of one response at a time.
        every: Whether all tests are run, though one has failed.
    """

    limits: Limits = field(default_factory=Limits)
    float_tolerance: float | None = None
    parallel: int = 4
    every: bool = False


async def grade_program(code: str, tests: StdinTests, runner: Runner, grading: Grading) -> Verdict:
    """Return what became of a program in its tests.

    Raises:
        NoVerdictError: There is no verdict.
    """
    levels: set[str] = set()

    async def one(index: int) -> CaseResult:
        run = await runner.run(code, tests.inputs[index], _allowing(tests.outputs[index], grading.limits))
        if run.sandbox:
            levels.add(run.sandbox)
        if run.status != "ok":
            return CaseResult(index, status_of(run), run.error, tests.inputs[index], run.stdout)
        right = same_output(run.stdout, tests.outputs[index], grading.float_tolerance)
        return CaseResult(index, "passed" if right else "wrong_answer", None, tests.inputs[index], run.stdout)

    results = await in_parallel(one, len(tests.inputs), grading.parallel, every=grading.every)
    return Verdict(results, min(levels, default=None))


def _allowing(expected: str, limits: Limits) -> Limits:
    """Return limits under which a program may print what is expected of it, and some white space."""
    if 4 * len(expected) < limits.output_bytes:
        return limits
    return replace(limits, output_bytes=max(limits.output_bytes, 2 * len(expected.encode("utf-8", "replace"))))


async def in_parallel(
    one: Callable[[int], Awaitable[CaseResult]], count: int, parallel: int, *, every: bool
) -> list[CaseResult]:
    """Run tests, some at a time; once one has failed, those behind it are given up, those before it are not.

    So the first failure is the same one in every run, however long each test takes.
    """
    results = [CaseResult(index, "not_run") for index in range(count)]
    waiting = iter(range(count))
    under_way: dict[asyncio.Future[CaseResult], int] = {}
    first_failure = count
    try:
        while True:
            while len(under_way) < parallel and (index := next(waiting, None)) is not None:
                if index > first_failure:
                    break
                under_way[asyncio.ensure_future(one(index))] = index
            if not under_way:
                return [result if every or result.index <= first_failure else _not_run(result) for result in results]
            done, _ = await asyncio.wait(under_way, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                index = under_way.pop(task)
                results[index] = task.result()
                if results[index].status != "passed" and not every:
                    first_failure = min(first_failure, index)
            for task in [task for task, index in under_way.items() if index > first_failure]:
                del under_way[task]
                task.cancel()
    finally:
        for task in under_way:
            task.cancel()


def _not_run(result: CaseResult) -> CaseResult:
    return CaseResult(result.index, "not_run")
