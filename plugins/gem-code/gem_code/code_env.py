"""``CodeEnv``: a problem, and a program that is run against its tests."""

from __future__ import annotations

import re
from typing import Any, ClassVar, Literal, Unpack

from gem_code.cases import AssertionTests, CallTests, Tests, longest, read_tests
from gem_code.fences import last_program
from gem_code.function_form import grade_assertions, grade_calls
from gem_code.program_form import Grading, grade_program
from gem_code.runner import NoVerdictError, Runner
from gem_code.verdicts import CaseResult, Verdict
from gem_core.background import run_sync
from gem_core.data import DatasetEnv, DatasetOptions, Grade, Row, RowSource
from gem_core.errors import ArgumentError, GradingError
from gem_core.types import TERMINAL_STATE, Concurrency, ResetResult, StepResult
from gem_tools.python import Limits

RewardRule = Literal["all", "fraction"]

_MOST_CHARACTERS = 1_000_000
"""Of a program; contests take 65,536 bytes."""


class CodeEnv(DatasetEnv):
    """Asks for a program and runs it against the tests of the problem, in the sandbox of gem-tools.

    The answer is the last fenced block of the response that is marked ``python`` or ``py``; without one, the last that
    is not marked; thinking is left out. Tests come in either form: standard input and output, or functions with
    assertions; see ``gem_code.cases.read_tests``. None of what is expected is ever in reach of the program.

    ``info`` says ``correct``, ``status`` (``"passed"``, or why the first test that failed did: ``"wrong_answer"``,
    ``"timeout"``, ``"memory"``, ``"output_limit"``, ``"runtime_error"``, ``"compile_error"``; or ``"no_code"``),
    ``passed`` of ``total``, ``tests`` with the status of each, ``first_failure`` with its input (cut), and the level of
    the ``sandbox``. A sandbox that fails, and tests that are malformed, are ``info["error"]``, never a reward of 0.

    Args:
        rows: See ``DatasetEnv``; there ``dataset_name``, ``split`` and more are explained too.
        test_key: Column of the tests.
        entry_key: Column of the name of the function under test, where there is one.
        solution_key: Column of a right program, which ``gold_action`` answers with, where there is one. A body that
            completes the function of the question, as in HumanEval, will do.
        reward: ``"all"``: 1 if all tests pass, else 0, and nothing more is run once a test has failed. ``"fraction"``:
            the part of the tests that passed.
        format_error_reward: Reward of a response without a program.
        max_tests: Tests that are run, those with the longest inputs; None for all. Assertions are always all run.
        timeout_s: Limit of each run of the program in seconds, on the clock and of computing. All calls of a function
            are one run.
        memory_mb: Megabytes that a run may use.
        max_output_bytes: Bytes that a run may print.
        float_tolerance: Numbers are equal that differ by this, or by this part; None compares text. See
            ``gem_code.comparing.same_output``.
        sandbox: Level of isolation: ``"auto"``, ``"bubblewrap"``, ``"docker"`` or ``"process"``; see gem-tools.
        **options: See ``DatasetEnv``.

    Source: rewards and the choice of tests are those of gem-llm's CodeEnv, whose results are published.
    """

    concurrency: ClassVar[Concurrency] = "async"
    answer_fences: ClassVar[tuple[str, ...]] = ("python", "py", "")

    def __init__(
        self,
        rows: RowSource | None = None,
        *,
        test_key: str = "tests",
        entry_key: str = "entry_point",
        solution_key: str = "solution",
        reward: RewardRule = "all",
        format_error_reward: float = -0.1,
        max_tests: int | None = 12,
        timeout_s: float = 10.0,
        memory_mb: int = 512,
        max_output_bytes: int = 4_000_000,
        float_tolerance: float | None = None,
        sandbox: str = "auto",
        **options: Unpack[DatasetOptions],
    ) -> None:
        _check("reward", reward in ("all", "fraction"), "'all' or 'fraction'", reward)
        _check("max_tests", max_tests is None or _is_count(max_tests), "a whole number from 1 up, or None", max_tests)
        _check("timeout_s", _is_number(timeout_s) and timeout_s > 0, "seconds above 0", timeout_s)
        _check("memory_mb", _is_count(memory_mb), "whole megabytes from 1 up", memory_mb)
        _check("max_output_bytes", _is_count(max_output_bytes), "whole bytes from 1 up", max_output_bytes)
        fits = float_tolerance is None or (_is_number(float_tolerance) and float_tolerance >= 0)
        _check("float_tolerance", fits, "a number from 0 up, or None", float_tolerance)
        options.setdefault("question_key", "problem")
        options.setdefault("answer_key", test_key)
        super().__init__(rows, **options)
        self.entry_key = entry_key
        self.solution_key = solution_key
        self.reward: RewardRule = reward
        self.format_error_reward = float(format_error_reward)
        self.return_range = (min(0.0, self.format_error_reward), max(1.0, self.format_error_reward))
        self.max_tests = max_tests
        self.grading = Grading(
            limits=Limits(wall_s=timeout_s, memory_mb=memory_mb, output_bytes=max_output_bytes),
            float_tolerance=float_tolerance,
            every=reward == "fraction",
        )
        self.runner = Runner(sandbox)

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Ask a problem; see ``DatasetEnv.reset``."""
        return self.reset(seed=seed, options=options)

    def step(self, action: str) -> StepResult:
        """Wait for ``step_async``."""
        return run_sync(self.step_async(action))

    async def step_async(self, action: str) -> StepResult:
        """Run the program of the response against the tests; the task is over."""
        index, row = self._index, self._row
        info: dict[str, Any] = {"task_id": self.task_id(index, row), "index": index}
        try:
            grade = await self.grade_async(action, row)
        except GradingError as error:
            kind = "sandbox" if isinstance(error, NoVerdictError) else "grading"
            where = "" if kind == "sandbox" else f"row {index} ({info['task_id']!r}): "
            info["error"] = {"kind": kind, "message": f"{where}{error}"}
            return TERMINAL_STATE, 0.0, False, True, info
        info |= {**grade.info, "correct": grade.correct, "parsed_action": grade.answer}
        return TERMINAL_STATE, float(grade.reward), True, False, info

    def grade(self, action: str, row: Row) -> Grade:
        """Wait for ``grade_async``."""
        return run_sync(self.grade_async(action, row))

    async def grade_async(self, action: str, row: Row) -> Grade:
        """Return the verdict on a response.

        Raises:
            NoVerdictError: The sandbox failed.
            GradingError: The tests of the row are malformed.
        """
        tests, indices = longest(self.tests(row), self.max_tests)
        code = self.program(action)
        if code is None:
            return Grade(self.format_error_reward, False, None, {"status": "no_code"})
        verdict = await self._verdict(code, tests)
        reward = verdict.fraction if self.reward == "fraction" else float(verdict.correct)
        return Grade(reward, verdict.correct, code, _in_the_row(verdict, indices).info())

    def program(self, action: str) -> str | None:
        """Return the program of a response, or None where it has none."""
        return last_program(action, (*self.answer_fences, "python3"))

    def tests(self, row: Row) -> Tests:
        """Return the tests of a row.

        Raises:
            GradingError: They are malformed.
        """
        return read_tests(row[self.answer_key], entry=row.get(self.entry_key), prompt=row[self.question_key])

    def sample_random_action(self) -> str:
        """Return a program of the right form that answers the same to every test: rarely right."""
        answer = ("0", "1", "-1", "True", "'YES'", "'NO'", "[]", "''", "None")[int(self.action_random.integers(9))]
        try:
            tests = self.tests(self._row)
        except GradingError:
            tests = None
        name = tests.entry if isinstance(tests, AssertionTests) else getattr(tests, "function", None)
        code = f"print({answer})" if name is None else f"def {name}(*arguments):\n    return {answer}"
        return f"```python\n{code}\n```"

    def gold_response(self, row: Row) -> str | None:
        """Return the right program of a row in a fenced block; None where it has none."""
        solution = row.get(self.solution_key)
        if not isinstance(solution, str) or not solution.strip():
            return None
        entry = row.get(self.entry_key)
        completes = isinstance(entry, str) and not re.search(rf"^(?:async )?def {re.escape(entry)}\b", solution, re.M)
        return f"```python\n{row[self.question_key] if completes else ''}{solution}\n```"

    async def _verdict(self, code: str, tests: Tests) -> Verdict:
        if len(code) > _MOST_CHARACTERS:
            count = 1 if isinstance(tests, AssertionTests) else len(tests.inputs)
            first = CaseResult(0, "compile_error", f"the program has more than {_MOST_CHARACTERS:,} characters")
            return Verdict([first, *(CaseResult(index, "not_run") for index in range(1, count))])
        if isinstance(tests, AssertionTests):
            return await grade_assertions(code, tests, self.runner, self.grading)
        if isinstance(tests, CallTests):
            return await grade_calls(code, tests, self.runner, self.grading)
        return await grade_program(code, tests, self.runner, self.grading)


def _in_the_row(verdict: Verdict, indices: list[int]) -> Verdict:
    """Give the tests the indices that they have in the row."""
    if not indices:
        return verdict
    return Verdict([test.at(indices[test.index]) for test in verdict.tests], verdict.sandbox)


def _check(name: str, fits: bool, expected: str, value: object) -> None:
    if not fits:
        raise ArgumentError(f"{name} must be {expected}, not {value!r}")


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value and abs(value) <= 1e6
