"""Scores from the rows of an index: what counts, what counts apart, and how it is summed up."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core import Episode, Response
from gem_core.records import RunSummary, Transition
from gem_eval.records import Row
from gem_eval.scores import Score, compute_scores
from gem_eval.statistics import mean, pass_at, pass_hat, rate

if TYPE_CHECKING:
    from random import Random


@dataclass(frozen=True)
class Played:
    """An episode, as the index tells of it."""

    row: str
    success: bool | None
    episode_return: float = 0.0
    epoch: int = 0
    id: str = "math:Sums"
    model: str = "random"
    error: str | None = None
    cut_off: str | None = None
    unreadable: bool = False
    return_range: tuple[float, float] | None = None
    seat: str | None = None


def successes(*episodes: Played) -> Score:
    """The first score, which is by success."""
    score = compute_scores(episodes)[0]
    assert score.metric == "success"
    return score


EPISODES = st.lists(
    st.builds(
        Played,
        row=st.sampled_from("abcd"),
        success=st.sampled_from([True, False, None]),
        episode_return=st.floats(-5, 5),
        id=st.sampled_from(["math:Sums", "qa:Facts"]),
        error=st.sampled_from([None, None, "boom"]),
        cut_off=st.sampled_from([None, None, "turns"]),
        unreadable=st.booleans(),
    ),
    max_size=12,
)


def test_what_is_debatable_counts_apart_and_the_score_otherwise_is_told() -> None:
    """Errors and unscored episodes are left out, truncated and unreadable ones are failures."""
    score = successes(Played("a", True), Played("b", True), Played("c", None, error="boom"))
    assert (score.mean, score.episodes, score.rows, score.errors, score.unscored) == (1.0, 2, 2, 1, 0)
    assert score.with_errors == pytest.approx(2 / 3)
    score = successes(Played("a", True), Played("b", False), Played("c", False, cut_off="turns"))
    assert (score.mean, score.truncated) == (pytest.approx(1 / 3), 1)
    assert score.without_truncated == rate([[1], [0]])
    score = successes(Played("a", True), Played("b", False, unreadable=True), Played("c", None))
    assert (score.mean, score.episodes, score.rows, score.unscored, score.unreadable) == (0.5, 3, 2, 1, 1)
    assert (score.without_unreadable, score.with_unscored) == (rate([[1]]), pytest.approx(1 / 3))
    # The same without them, or nothing left without them.
    score = successes(Played("a", False), Played("b", False, cut_off="time"))
    assert (score.with_errors, score.without_truncated) == (None, None)
    assert successes(Played("a", False, cut_off="time")).without_truncated is None


def test_episodes_without_a_value_leave_a_row_of_counts() -> None:
    """Errors, and returns that are not finite."""
    (score,) = compute_scores([Played("a", None, error="boom")])
    assert (score.metric, score.mean, score.episodes, score.rows, score.errors) == ("return", None, 0, 0, 1)
    (score,) = compute_scores([Played("a", None, float("inf")), Played("b", None, 2.0), Played("c", None, 3.0)])
    assert (score.mean, score.rows, score.episodes) == (2.5, 2, 3)


def test_pass_at_goes_by_powers_of_two_to_the_number_of_epochs() -> None:
    """An error leaves its row out of the largest k, which is told, and takes it from no other; one epoch has none."""
    played = [Played("a", epoch < 2, epoch=epoch) for epoch in range(7)]
    played += [Played("b", epoch < 1, epoch=epoch, error="boom" if epoch == 6 else None) for epoch in range(7)]
    score = successes(*played, Played("c", None, error="boom"))
    counts = [(7, 2), (6, 1)]
    assert score.pass_at == {str(k): pass_at(counts, k) for k in (1, 2, 4, 7)}
    assert score.pass_hat == {str(k): pass_hat(counts, k) for k in (1, 2, 4, 7)}
    assert score.pass_left_out == {"1": 1, "2": 1, "4": 1, "7": 2}
    assert score.pass_at["1"].mean == pytest.approx(score.mean)
    assert successes(Played("a", True), Played("b", True)).pass_at == {}


def test_a_return_has_an_interval_within_the_declared_range() -> None:
    """Where success is what is paid, it is that of success; where nothing is declared, or wrongly, no range holds."""
    wins = [Played(row, True, 1.0) for row in "abcd"]
    solved, paid = compute_scores(wins)
    assert (paid.mean, paid.stderr, paid.low, paid.high) == (solved.mean, solved.stderr, solved.low, solved.high)
    four = [
        Played(row, None, value, return_range=(-0.1, 1.0)) for row, value in zip("abcd", (0, 0.3, 1, 0.9), strict=True)
    ]
    (within,) = compute_scores(four)
    assert (within.mean, within.stderr, within.low, within.high) == mean([[0], [0.3], [1], [0.9]], within=(-0.1, 1.0))
    assert -0.1 <= (within.low or -1) < (within.high or 2) <= 1
    for wrong in (replace(four[0], episode_return=2.0), replace(four[0], return_range=None)):
        (free,) = compute_scores([wrong, *four[1:]])
        assert free.low == mean([[wrong.episode_return], [0.3], [1], [0.9]]).low


@pytest.mark.parametrize("declared", [None, (-0.1, 1.0)])
@pytest.mark.parametrize("rewards", [(1.0,) * 5, (0.0, 1.0, 1.0), (0.25, 0.5, 0.75, 0.5), (0.5, 0.5)])
def test_gem_run_and_gem_eval_have_one_standard_error(
    rewards: tuple[float, ...], declared: tuple[float, float] | None
) -> None:
    """Of the same episodes: five wins are not sure in one command, and open in the other."""
    summary, rows = RunSummary([]), []
    for seed, reward in enumerate(rewards):
        turn = Transition("o", Response("a"), reward, True, False, {"correct": reward == 1.0})
        episode = Episode("t:A", seed, "o", {}, [turn], return_range=declared)
        summary.add(episode)
        rows.append(Row.of(episode.to_dict(), seed + 1, 0, 1))
    found = {score.metric: score.stderr for score in compute_scores(rows)}
    told = summary.rows()[0]
    assert (found["success"], found["return"]) == (
        pytest.approx(told.success_standard_error),
        None if told.return_standard_error is None else pytest.approx(told.return_standard_error),
    )
    assert found["return"] or (declared is None and rewards == (0.5, 0.5))


def test_a_task_that_never_tells_has_no_success_rate() -> None:
    """Also where some of its episodes were cut off; one whose episodes were all cut off has a rate of 0."""
    silent = [Played("a", None, 2.0), Played("b", False, 1.0, cut_off="turns")]
    assert [(score.metric, score.mean, score.unscored) for score in compute_scores(silent)] == [("return", 1.5, 1)]
    assert successes(Played("a", False, cut_off="turns")).mean == 0
    # What one model's episodes tell of a task holds for the other's.
    told = compute_scores([Played("a", True), Played("a", False, cut_off="turns", model="other")])
    assert [score.metric for score in told if score.model == "other"] == ["success", "return"]


def test_several_environments_are_summed_up_by_model() -> None:
    """Each row weighs the same; rows of one name in two environments are two; a silent task says nothing of success."""
    played = [
        Played("a", True, 1.0),
        Played("a", False, 0.0, id="qa:Facts"),
        Played("b", False, 0.0, id="qa:Facts"),
        Played("a", None, 7.0, id="game:Silent"),
        Played("a", True, 1.0, model="other"),
    ]
    found = [(score.id, score.model, score.metric, score.mean, score.rows) for score in compute_scores(played)]
    assert found[-4:] == [
        ("math:Sums", "other", "success", 1.0, 1),
        ("math:Sums", "other", "return", 1.0, 1),
        ("all", "random", "success", pytest.approx(1 / 3), 3),
        ("all", "random", "return", 2.0, 4),
    ]


@given(EPISODES, st.randoms(use_true_random=False))
def test_scores_do_not_depend_on_the_order_of_episodes(played: list[Played], random: Random) -> None:
    """Nor are intervals narrower when each epoch is there twice, and all that is said is plain JSON in its bounds."""
    found = {(score.id, score.metric): score for score in compute_scores(played)}
    random.shuffle(mixed := [*played])
    assert {(score.id, score.metric): score for score in compute_scores(mixed)} == found
    twice = compute_scores([*played, *(replace(episode, epoch=1) for episode in played)])
    for again in twice:
        score = found[again.id, again.metric]
        assert (again.mean, again.low, again.high) == pytest.approx((score.mean, score.low, score.high), abs=1e-9)
        json.dumps(score.to_dict(), allow_nan=False)
        if score.low is not None and score.mean is not None and score.high is not None:
            assert score.low <= score.mean <= score.high
            assert score.metric == "return" or 0 <= score.low <= score.high <= 1
