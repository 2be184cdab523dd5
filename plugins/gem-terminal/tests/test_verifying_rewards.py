"""From verdicts to rewards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gem_core.errors import UsageError
from gem_terminal.tasks.task import Container, Environment, Step, Task, Verifier
from gem_terminal.verifying.verdict import TestResult, Verdict, goes_on, reward_of, reward_of_steps

A, B, C = TestResult("a", True), TestResult("b", False, weight=3.0), TestResult("c", True, weight=0.0)
HALF = Verdict(False, 0.4, (A, B, C))
STEP = Step("one", "do", Verifier({}, ("true",), 1.0, "reward_file"))


def task(steps: int, how: str) -> Task:
    return Task("t", Path("/t"), "harbor", Environment(Container()), (STEP,) * steps, "d", reward_of_steps=how)  # type: ignore[arg-type]


def test_each_way_of_rewarding_gives_its_own_number() -> None:
    assert reward_of(HALF) == 0.0
    assert reward_of(HALF, "fraction") == pytest.approx(2 / 3)
    assert reward_of(HALF, "weighted") == 0.25
    assert reward_of(HALF, "weighted", weights={"a": 1, "b": 1}) == 0.5
    assert reward_of(HALF, "score") == 0.4
    assert reward_of(Verdict(True, 1.0, (A, C))) == 1.0


def test_weighted_test_that_did_not_run_counts_as_failed() -> None:
    assert reward_of(HALF, "weighted", weights={"a": 1.0, "never_ran": 1.0}) == 0.5


@pytest.mark.parametrize("how", ["all", "fraction", "weighted", "score"])
def test_problem_is_rewarded_with_nothing_whatever_stands_beside_it(how: str) -> None:
    assert reward_of(Verdict(True, 1.0, (A,), problem="timeout"), how) == 0.0  # type: ignore[arg-type]


def test_tests_that_contradict_the_verdict_do_not_count() -> None:
    """A report can be forged more easily than the reward file, which decides."""
    assert reward_of(Verdict(False, 0.0, (A, C)), "fraction") == 0.0
    assert reward_of(Verdict(True, 1.0, (A, B)), "fraction") == 1.0
    assert reward_of(Verdict(False, 0.7), "fraction") == 0.7


def test_weights_of_no_test_are_an_error_that_names_some() -> None:
    with pytest.raises(UsageError, match=r"^none of the tests has a weight\. Give weights for some of: a, b, c\.$"):
        reward_of(HALF, "weighted", weights={})


def test_steps_are_rewarded_by_mean_or_by_the_last_and_giving_up_does_not_pay() -> None:
    assert reward_of_steps(task(2, "mean"), [1.0, 0.5]) == 0.75
    assert reward_of_steps(task(2, "mean"), [1.0]) == 0.5
    assert reward_of_steps(task(2, "final"), [0.0, 1.0]) == 1.0
    assert reward_of_steps(task(2, "final"), [1.0]) == 0.0


def test_task_ends_after_a_step_below_its_least_reward() -> None:
    strict = replace(STEP, min_reward=0.5)
    assert goes_on(STEP, Verdict(False, 0.0))
    assert goes_on(strict, Verdict(False, 0.5))
    assert not goes_on(strict, Verdict(False, 0.4))
    assert not goes_on(replace(STEP, min_reward=-1.0), Verdict(False, 0.0, problem="timeout"))
