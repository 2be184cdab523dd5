"""What became of a program in its tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from gem_tools.python import Outcome

Status = Literal[
    "passed", "wrong_answer", "timeout", "memory", "output_limit", "runtime_error", "compile_error", "not_run"
]

_SHOWN = 300
_COMPILE_ERRORS = ("SyntaxError", "IndentationError", "TabError")
_BY_LIMIT: dict[str, Status] = {"timeout": "timeout", "cpu": "timeout", "memory": "memory", "output": "output_limit"}


@dataclass(frozen=True)
class CaseResult:
    """What became of one test.

    Args:
        index: Of the test in its row, from 0.
        status: ``"passed"``, why it failed, or ``"not_run"``.
        error: The program's exception, in one line.
        input: What the program was given, cut.
        output: What it printed or returned, cut.
    """

    index: int
    status: Status
    error: str | None = None
    input: str | None = None
    output: str | None = None

    def at(self, index: int) -> CaseResult:
        """Return the same for another index."""
        return replace(self, index=index)


@dataclass(frozen=True)
class Verdict:
    """What became of all tests that were tried, in their order.

    Args:
        tests: One for each test.
        sandbox: Level of isolation in which the program ran.
    """

    tests: Sequence[CaseResult]
    sandbox: str | None = None

    @property
    def passed(self) -> int:
        """Number of tests that passed."""
        return sum(test.status == "passed" for test in self.tests)

    @property
    def correct(self) -> bool:
        """Whether all passed."""
        return self.passed == len(self.tests)

    @property
    def fraction(self) -> float:
        """Part of the tests that passed."""
        return self.passed / len(self.tests)

    @property
    def status(self) -> Status:
        """``"passed"``, or why the first test that failed did."""
        failed = self.first_failure
        return "passed" if failed is None else failed.status

    @property
    def first_failure(self) -> CaseResult | None:
        """The first test that was run and failed."""
        return next((test for test in self.tests if test.status not in ("passed", "not_run")), None)

    def info(self) -> dict[str, Any]:
        """Return it as plain JSON, without anything that was expected of the program."""
        found: dict[str, Any] = {
            "status": self.status,
            "passed": self.passed,
            "total": len(self.tests),
            "tests": [{"index": test.index, "status": test.status} for test in self.tests],
            "sandbox": self.sandbox,
        }
        failed = self.first_failure
        if failed is not None:
            found["first_failure"] = {
                "index": failed.index,
                "status": failed.status,
                "input": shortened(failed.input),
                "output": shortened(failed.output),
                "error": shortened(failed.error),
            }
        return found


def status_of(run: Outcome) -> Status:
    """Return what a run that did not finish counts as."""
    if run.status in _BY_LIMIT:
        return _BY_LIMIT[run.status]
    name = (run.error or "").partition(":")[0].strip()
    if name == "MemoryError":
        return "memory"
    return "compile_error" if name in _COMPILE_ERRORS else "runtime_error"


def shortened(text: str | None) -> str | None:
    """Return a text cut in its middle."""
    if text is None or len(text) <= _SHOWN:
        return text
    half = _SHOWN // 2
    return f"{text[:half]} … ({len(text) - 2 * half} characters) … {text[-half:]}"
