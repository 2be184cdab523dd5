"""Whole programs: what counts as right, and which tests are run."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from gem_code.cases import StdinTests
from gem_code.program_form import Grading, grade_program, in_parallel
from gem_code.runner import NoVerdictError
from gem_code.verdicts import CaseResult, shortened
from gem_tools.python import Limits, Outcome

if TYPE_CHECKING:
    from judging import Judge

DOUBLE = {"inputs": ["1\n", "2\n", "21\n"], "outputs": ["2\n", "4\n", "42\n"]}


class Scripted:
    """A runner that knows what becomes of each input, and can hold back some of them."""

    def __init__(self, outcomes: dict[str, Outcome], held: frozenset[str] = frozenset()) -> None:
        self.outcomes, self.held = outcomes, held
        self.begun: list[str] = []
        self.cancelled: list[str] = []
        self.at_once = self.most_at_once = 0

    async def run(self, program: str, stdin: str, limits: Limits) -> Outcome:
        """Return the outcome, or wait for ever."""
        self.begun.append(stdin)
        self.at_once += 1
        self.most_at_once = max(self.most_at_once, self.at_once)
        try:
            if stdin in self.held:
                await asyncio.Event().wait()
            for _ in range(3):
                await asyncio.sleep(0)
            return self.outcomes[stdin]
        except asyncio.CancelledError:
            self.cancelled.append(stdin)
            raise
        finally:
            self.at_once -= 1


def test_what_is_expected_may_always_be_printed(judge: Judge) -> None:
    """Whatever the limit of output; a program that prints far more meets it."""
    tests = {"inputs": ["3000"], "outputs": ["1\n" * 3000]}
    limits = Limits(wall_s=20.0, output_bytes=1000)
    assert judge("print('1\\n' * int(input()))", tests, limits=limits).correct
    assert judge("print('1\\n' * 10 * int(input()))", tests, limits=limits).status == "output_limit"


@pytest.mark.parametrize("name", ["'/dev/stdin'", "0", "'/dev/fd/0'"])
def test_input_is_there_under_its_usual_names(judge: Judge, name: str) -> None:
    """Each test has its own."""
    assert judge(f"print(2 * int(open({name}).read()))", DOUBLE).correct


@pytest.mark.parametrize(
    ("code", "status", "error"),
    [
        ("print(int(input()) + 1)", "wrong_answer", None),
        ("", "wrong_answer", None),
        ("print(2 * int(input())", "compile_error", "SyntaxError: '(' was never closed"),
        ("if True:\nprint(1)", "compile_error", "IndentationError: expected an indented block after 'if' statement"),
        ("x = int(input())\nprint(2 * x)\n1 / 0", "runtime_error", "ZeroDivisionError: division by zero"),
        ("import sys\nprint(2 * int(input()))\nsys.exit(3)", "runtime_error", None),
        ("raise MemoryError", "memory", "MemoryError"),
    ],
)
def test_reasons_of_failure_are_told_apart(judge: Judge, code: str, status: str, error: str | None) -> None:
    """A program that prints the right answer and then fails has failed."""
    verdict = judge(code, DOUBLE, every=True)
    assert verdict.status == status
    assert verdict.fraction == (1 / 3 if code.startswith("print(int") else 0)
    failed = verdict.first_failure
    assert failed is not None
    assert error is None or error in str(failed.error)


def test_the_rest_is_not_run_after_a_failure() -> None:
    """Once a test has failed, nothing that comes later is begun; what is under way there is given up."""
    runner = Scripted(
        {"a": Outcome(status="ok", stdout="1"), "b": Outcome(status="ok", stdout="wrong")}, held=frozenset("cde")
    )
    tests = StdinTests(tuple("abcde"), ("1",) * 5)
    verdict = asyncio.run(grade_program("", tests, runner, Grading(parallel=3)))
    assert [test.status for test in verdict.tests] == ["passed", "wrong_answer", "not_run", "not_run", "not_run"]
    assert "e" not in runner.begun
    assert runner.cancelled
    assert runner.at_once == 0


def test_the_first_failure_does_not_depend_on_which_test_is_fastest() -> None:
    """A later failure that is known first waits for the tests before it."""

    async def one(index: int) -> CaseResult:
        for _ in range(10 - index):
            await asyncio.sleep(0)
        return CaseResult(index, "passed" if index == 0 else "wrong_answer")

    results = asyncio.run(in_parallel(one, 6, 6, every=False))
    assert [result.status for result in results] == ["passed", "wrong_answer", *["not_run"] * 4]


def test_every_test_is_run_for_the_fraction() -> None:
    """Some at a time, never more than asked for."""
    outcomes = {name: Outcome(status="ok", stdout="1" if name in "bd" else "0") for name in "abcdefgh"}
    runner = Scripted(outcomes)
    tests = StdinTests(tuple("abcdefgh"), ("1",) * 8)
    verdict = asyncio.run(grade_program("", tests, runner, Grading(parallel=3, every=True)))
    assert verdict.fraction == 0.25
    assert sorted(runner.begun) == list("abcdefgh")
    assert runner.most_at_once == 3


@pytest.mark.parametrize(
    ("run", "status"),
    [
        (Outcome(status="timeout"), "timeout"),
        (Outcome(status="cpu"), "timeout"),
        (Outcome(status="memory"), "memory"),
        (Outcome(status="output"), "output_limit"),
        (Outcome(status="killed", stdout="1"), "runtime_error"),
        (Outcome(status="exit", exit_code=1, stdout="1"), "runtime_error"),
        (Outcome(status="ok", exit_code=0, stdout="1"), "passed"),
        (Outcome(status="error", exit_code=1, stdout="1", error="ValueError: x"), "runtime_error"),
        (Outcome(status="error", exit_code=1, stdout="1", error="TabError: x"), "compile_error"),
    ],
)
def test_what_the_sandbox_says_becomes_a_status(run: Outcome, status: str) -> None:
    """A right output does not help a program that was ended."""
    verdict = asyncio.run(grade_program("", StdinTests(("a",), ("1",)), Scripted({"a": run}), Grading()))
    assert verdict.status == status


def test_a_sandbox_that_fails_is_no_verdict() -> None:
    """And what is under way is given up."""

    class Failing(Scripted):
        async def run(self, program: str, stdin: str, limits: Limits) -> Outcome:
            if stdin == "b":
                raise NoVerdictError("it is gone")
            return await super().run(program, stdin, limits)

    runner = Failing({}, held=frozenset("ac"))
    with pytest.raises(NoVerdictError, match="it is gone"):
        asyncio.run(grade_program("", StdinTests(tuple("abc"), ("1",) * 3), runner, Grading()))
    assert runner.at_once == 0


def test_long_texts_are_cut_in_the_middle() -> None:
    """To a readable length."""
    assert shortened("x" * 300) == "x" * 300
    cut = shortened("a" * 5000 + "z" * 5000)
    assert cut == "a" * 150 + " … (9700 characters) … " + "z" * 150
    assert shortened(None) is None
