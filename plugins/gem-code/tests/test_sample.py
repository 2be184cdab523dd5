"""code:Sample: its problems are there, can be solved, and are not solved by plausible mistakes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import gem_code
import gem_core as gem
from gem_code.cases import AssertionTests, StdinTests, read_tests
from gem_core.testing import check_env

if TYPE_CHECKING:
    from code_problems.problem import Problem
    from judging import Judge

code_sample = pytest.importorskip("code_sample", reason="the scripts are not beside the plugin")
pytestmark = pytest.mark.thorough

ROWS = Path(gem_code.__file__).parent / "data" / "sample.jsonl"
PROBLEMS = code_sample.PROBLEMS
BY_ID = {problem.id: problem for problem in PROBLEMS}


def test_the_file_is_what_the_problems_give() -> None:
    """After a change there: ``python scripts/code_sample.py``."""
    assert ROWS.read_text(encoding="utf-8") == code_sample.as_text()


def test_there_are_enough_problems_in_both_forms() -> None:
    """Of all levels, under names of their own, each with tests enough."""
    rows = [json.loads(line) for line in ROWS.read_text(encoding="utf-8").splitlines()]
    assert [row["id"] for row in rows] == [problem.id for problem in sorted(PROBLEMS, key=lambda p: p.level)]
    assert len({row["id"] for row in rows}) == len(rows)
    forms = [read_tests(row["tests"], entry=row["entry_point"], prompt=row["problem"]) for row in rows]
    programs = [form for form in forms if isinstance(form, StdinTests)]
    functions = [form for form in forms if isinstance(form, AssertionTests)]
    assert len(programs) >= 18
    assert len(functions) >= 12
    assert {row["level"] for row in rows} == {1, 2, 3}
    assert all(len(form.inputs) >= 6 for form in programs)
    assert all(form.source.count("assert ") >= 6 for form in functions)
    assert sum("check(candidate)" in form.source for form in functions) >= 6
    assert sum("check(candidate)" not in form.source for form in functions) >= 3


def test_every_problem_has_two_wrong_programs() -> None:
    """At least."""
    assert [problem.id for problem in PROBLEMS if len(problem.wrong) < 2] == []


def test_no_statement_or_row_holds_a_solution() -> None:
    """The rows are all that ships in the wheel."""
    text = ROWS.read_text(encoding="utf-8")
    assert [
        p.id for p in PROBLEMS if p.reference in text or any(json.dumps(w)[1:-1] in text for w in p.wrong.values())
    ] == []


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.id)
def test_the_reference_passes_and_mistakes_fail(problem: Problem, judge: Judge) -> None:
    """The reference in all tests; each wrong program passes none that it should not, and not all."""
    tests = code_sample.written_tests(problem)
    options = {"entry": problem.function, "prompt": problem.statement}
    assert judge(problem.reference, tests, **options).correct
    for mistake, code in problem.wrong.items():
        verdict = judge(code, tests, **options)
        assert not verdict.correct, mistake
        assert verdict.status in ("wrong_answer", "runtime_error"), mistake


def test_what_the_environment_promises_is_kept() -> None:
    """All of it."""
    assert check_env("code:Sample").broken == {}


def test_an_agent_with_the_references_solves_all() -> None:
    """By ``rollout``, many at a time."""

    def solver(observation: str, context: gem.Context) -> str:
        return f"Here it is:\n```python\n{BY_ID[context.info['task_id']].reference}```\nDone."

    vec = gem.make_vec("code:Sample", num_envs=16)
    episodes = list(gem.rollout(vec, solver))
    vec.close()
    assert len(episodes) == len(PROBLEMS)
    assert [episode.success for episode in episodes] == [True] * len(PROBLEMS)
    assert {episode.final_info["status"] for episode in episodes} == {"passed"}


def test_random_programs_are_well_formed_and_rarely_right() -> None:
    """None is without code, none fails to compile."""
    env = gem.make("code:Sample")
    statuses = []
    for index in range(env.unwrapped.num_tasks):
        env.reset(seed=index, options={"index": index})
        statuses.append(env.step(env.unwrapped.sample_random_action())[4]["status"])
    assert not {"no_code", "compile_error"} & set(statuses)
    assert statuses.count("passed") <= 2
