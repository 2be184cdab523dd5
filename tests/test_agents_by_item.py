"""Items of a plan that name who acts, and what the environment wears; and limits that cut an episode off."""

from __future__ import annotations

from typing import Any

import pytest

import gem_core as gem
from gem_core import PlanItem
from gem_core.errors import ArgumentError, EpisodeLimitError, RequestError
from gem_core.rollouts import Context

ID = "game:GuessTheNumber-v0-easy"


def low(observation: Any) -> str:
    return "\\boxed{1}"


def high(observation: Any) -> str:
    return "\\boxed{2}"


def test_an_item_names_the_agent_that_acts() -> None:
    """Models are compared in one run, and each record says whose it is."""
    plan = [PlanItem(ID, seed=3, agent=name) for name in ("one", "two")]
    episodes = {each.agent: each for each in gem.rollout(ID, {"one": low, "two": high}, plan=plan)}
    assert [episodes[name].transitions[0].action for name in ("one", "two")] == ["\\boxed{1}", "\\boxed{2}"]
    rest = gem.rollout(ID, {"one": low, "two": high}, plan=plan, resume=[episodes["one"]])
    assert [each.agent for each in rest] == ["two"]


def test_an_item_that_names_no_agent_is_refused() -> None:
    """The message names those that there are."""
    with pytest.raises(ArgumentError, match=r"agent=None.*'one'"):
        list(gem.rollout(ID, {"one": low}, plan=[PlanItem(ID)]))


def test_a_resumed_run_refuses_an_episode_of_another_agent() -> None:
    """Swapped models would mix two scores."""
    done = list(gem.rollout(ID, {"one": low}, plan=[PlanItem(ID, agent="one")], seed=1))
    with pytest.raises(ArgumentError, match=r"'one'.*'two'"):
        list(gem.rollout(ID, {"two": low}, plan=[PlanItem(ID, agent="two")], resume=done))


@pytest.mark.parametrize("backend", ["sync", "process"])
def test_an_environment_wears_the_wrappers_among_its_arguments(backend: str) -> None:
    """One batch of different views, outside those that all have."""
    ids = [ID, (ID, {"wrappers": [["concat", {}]]})]
    with gem.make_vec(ids, backend=backend, wrappers="episode_stats", seed=1) as vector:
        episodes = list(gem.rollout(vector, low, episodes=1))
    assert sorted([name for name, _ in each.wrappers] for each in episodes) == [
        ["episode_stats"],
        ["episode_stats", "concat"],
    ]
    assert all("wrappers" not in each.kwargs for each in episodes)


def test_an_unknown_wrapper_among_the_arguments_is_refused_at_once() -> None:
    """As for the wrappers of all."""
    with pytest.raises(gem.errors.UnknownWrapperError, match="concatt"):
        gem.make_vec([(ID, {"wrappers": "concatt"})])


def test_a_limit_cuts_an_episode_off_with_its_name() -> None:
    """It is truncated, counts as not solved, and is no error."""

    def limited(observation: Any, context: Context) -> str:
        if context.turn == 1:
            raise EpisodeLimitError("this costs too much", limit="cost")
        return "\\boxed{1}"

    (episode,) = gem.rollout(ID, limited, plan=[PlanItem(ID, seed=3)])
    assert (episode.cut_off, episode.error, episode.success, episode.turns) == ("cost", None, False, 1)


def test_an_error_says_its_cause() -> None:
    """So that those of one kind can be run again."""

    def failing(observation: Any) -> str:
        raise RequestError("too many requests", cause="rate_limit")

    (episode,) = gem.rollout(ID, failing, episodes=1)
    assert episode.error == {"kind": "agent", "cause": "rate_limit", "message": "too many requests"}
