"""What a run amounts to."""

from __future__ import annotations

from typing import Any

import pytest

from gem_core.records.episode import Episode, Transition
from gem_core.records.summary import RunSummary
from gem_core.types import Response


def episode(env_id: str, reward: float, *, terminated: bool = True, **info: Any) -> Episode:
    turn = Transition("o", Response("a"), reward, terminated, not terminated, info)
    return Episode(id=env_id, seed=1, observation="o", info={}, transitions=[turn])


def test_errors_count_apart_and_in_no_mean() -> None:
    """A failure of the machinery is never a reward of 0."""
    summary = RunSummary(["a:A"])
    summary.add(episode("a:A", 1.0, correct=True))
    summary.add(episode("a:A", 0.0, error={"kind": "x", "message": "broken"}))
    row = summary.rows()[0]
    assert (row.episodes, row.errors, row.success_rate, row.mean_return, row.mean_turns) == (1, 1, 1.0, 1.0, 1.0)
    assert summary.first_error == "a:A, seed 1: broken"


def test_episodes_that_were_cut_off_are_judged_and_not_solved() -> None:
    """Also where not one of them ended, so that none was told."""
    summary = RunSummary([])
    for _ in range(3):
        summary.add(episode("a:A", 0.0, terminated=False))
    row = summary.rows()[0]
    assert (row.success_rate, row.judged, row.cut_off_by_turns, row.cut_off_by_tokens) == (0.0, 3, 3, 0)
    summary.add(episode("a:A", 1.0, correct=True))
    summary.add(episode("a:A", 0.0, terminated=False, context_overflow=True))
    assert (row.success_rate, row.judged, row.cut_off_by_turns, row.cut_off_by_tokens) == (0.2, 5, 3, 1)


def test_a_task_that_ends_in_silence_never_tells() -> None:
    """Its episodes that were cut off are unknown as well; those of another task beside it are not."""
    summary = RunSummary([])
    for _ in range(2):
        summary.add(episode("a:Silent", 0.0, terminated=False))
        summary.add(episode("b:Tells", 0.0, terminated=False))
        summary.add(episode("a:Silent", 0.3))
    summary.add(episode("b:Tells", 1.0, correct=True))
    silent, tells, total = summary.rows()
    assert (silent.judged, silent.success_rate, silent.cut_off_by_turns) == (0, None, 2)
    assert (tells.judged, total.judged, total.successes, total.cut_off_by_turns) == (3, 3, 1, 4)


@pytest.mark.parametrize(
    ("solved", "judged", "rate_error", "return_error"),
    [
        (11, 50, 0.0583, 0.1184),
        (50, 50, 0.0098, None),
        (1, 1, 0.25, None),
        (5, 10, 0.1508, 0.3333),
    ],
)
def test_rates_and_means_come_with_a_standard_error(
    solved: int, judged: int, rate_error: float, return_error: float | None
) -> None:
    """Wilson's for the rate, and for a return that is the success; the sample's own for others, if it has a spread."""
    summaries = [RunSummary([]) for _ in range(3)]
    for number in range(judged):
        won = number < solved
        for summary, reward in zip(summaries, (float(won), 2.0 * won, 2.0 * won), strict=True):
            played = episode("a:A", reward, correct=won)
            played.return_range = (0.0, 2.0) if summary is summaries[2] else None
            summary.add(played)
    paid, row, ranged = (summary.to_dict(1.0)["environments"][0] for summary in summaries)
    assert row["success_standard_error"] == pytest.approx(rate_error, abs=5e-5)
    assert paid["return_standard_error"] == paid["success_standard_error"]
    assert ranged["return_standard_error"] == pytest.approx(2 * rate_error, abs=1e-4)
    found = row["return_standard_error"]
    assert found is return_error is None or found == pytest.approx(return_error, abs=5e-5)


def test_several_environments_get_a_row_for_all() -> None:
    """One environment alone does not."""
    summary = RunSummary(["a:A", "b:B"])
    summary.add(episode("a:A", 1.0, correct=True))
    summary.add(episode("b:B", 0.0, correct=False))
    assert [row.id for row in summary.rows()] == ["a:A", "b:B", "all"]
    assert summary.to_dict(2.0)["environments"][-1]["turns_per_second"] == 1.0
    assert [row.id for row in RunSummary(["a:A"]).rows()] == ["a:A"]


def test_tokens_are_counted_also_where_an_episode_failed() -> None:
    """They were spent; where none are reported the count is unknown, and not 0."""
    summary = RunSummary(["a:A", "b:B"])
    for env_id, info in (("a:A", {}), ("a:A", {"error": {"message": "broken"}}), ("b:B", {})):
        record = episode(env_id, 1.0, **info)
        if env_id == "a:A":
            record.transitions[0].action.usage = {"prompt_tokens": 1500, "completion_tokens": 4}
        summary.add(record)
    counts = [(row.prompt_tokens, row.completion_tokens) for row in summary.rows()]
    assert counts == [(3000, 8), (None, None), (3000, 8)]
    assert summary.to_dict(1.0)["environments"][0]["prompt_tokens"] == 3000
