"""Grade a program, without an environment around it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from gem_code.cases import CallTests, StdinTests, read_tests
from gem_code.function_form import grade_assertions, grade_calls
from gem_code.program_form import Grading, grade_program
from gem_code.verdicts import Verdict
from gem_tools.python import Limits

Judge = Callable[..., Verdict]


def grade(code: str, tests: Any, runner: Any, entry: str | None, prompt: str | None, **options: Any) -> Verdict:
    """Return the verdict on a program."""
    options.setdefault("limits", Limits(wall_s=20.0))
    read, grading = read_tests(tests, entry=entry, prompt=prompt), Grading(**options)
    if isinstance(read, StdinTests):
        return asyncio.run(grade_program(code, read, runner, grading))
    if isinstance(read, CallTests):
        return asyncio.run(grade_calls(code, read, runner, grading))
    return asyncio.run(grade_assertions(code, read, runner, grading))
