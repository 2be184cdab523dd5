"""All of HumanEval: every canonical solution passes, and each with one line broken fails."""

from __future__ import annotations

import ast
import asyncio
import gzip
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from gem_code.cases import AssertionTests
from gem_code.function_form import grade_assertions
from gem_code.program_form import Grading
from gem_code.runner import Runner

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from gem_code.verdicts import Verdict

Row = dict[str, Any]


@pytest.fixture(scope="module")
def rows(shared_data: Path) -> list[Row]:
    """The 164 problems."""
    with gzip.open(shared_data / "code" / "HumanEval.jsonl.gz", "rt", encoding="utf-8") as lines:
        return [json.loads(line) for line in lines]


def verdicts(rows: list[Row], codes: list[str]) -> list[Verdict]:
    """Grade one program for each row, all at once."""

    async def run() -> list[Verdict]:
        runner, grading = Runner(), Grading(every=True)
        tests = [AssertionTests(row["test"], row["entry_point"], row["prompt"]) for row in rows]
        pairs = zip(codes, tests, strict=True)
        return await asyncio.gather(*(grade_assertions(code, test, runner, grading) for code, test in pairs))

    return asyncio.run(run())


def test_every_canonical_solution_passes(rows: list[Row]) -> None:
    """As a whole function, and as the completion that the data set holds. There is no exception."""
    assert len(rows) == 164
    whole = verdicts(rows, [row["prompt"] + row["canonical_solution"] for row in rows])
    assert [row["task_id"] for row, verdict in zip(rows, whole, strict=True) if not verdict.correct] == []
    bodies = verdicts(rows, [row["canonical_solution"] for row in rows])
    assert [row["task_id"] for row, verdict in zip(rows, bodies, strict=True) if not verdict.correct] == []
    # Single assertions are counted: more than one for nearly every problem.
    assert sum(len(verdict.tests) for verdict in whole) > 1000
    assert sum(len(verdict.tests) == 1 for verdict in whole) <= 4


def test_every_solution_with_one_line_broken_fails(rows: list[Row]) -> None:
    """Its last ``return`` gives something else. There is no exception."""
    broken = [with_other_result(row) for row in rows]
    found = verdicts(rows, broken)
    assert [row["task_id"] for row, verdict in zip(rows, found, strict=True) if verdict.correct] == []
    assert {verdict.status for verdict in found} <= {"wrong_answer", "runtime_error"}


def with_other_result(row: Row) -> str:
    """Return the solution with one line changed: the last ``return`` of the function."""
    code = row["prompt"] + row["canonical_solution"]
    function = next(node for node in ast.parse(code).body if getattr(node, "name", None) == row["entry_point"])
    last = max((node for node in ast.walk(function) if isinstance(node, ast.Return)), key=lambda node: node.lineno)
    lines = code.splitlines()
    before = lines[last.lineno - 1][: last.col_offset]
    # Never what it was: of a truth value the other one, of all else a truth value.
    value = ast.get_source_segment(code, last.value) if last.value is not None else "None"
    lines[last.lineno - 1 : last.end_lineno] = [f"{before}return not ({value})"]
    return "\n".join(lines)
