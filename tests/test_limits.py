"""The turn limit and the episode statistics."""

from __future__ import annotations

from typing import Any

import pytest
from echo_env import TRACE, EchoEnv, ShortCut

import gem_core as gem
from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.registry import lookup as registry
from gem_core.wrappers.episode_stats import EpisodeStats
from gem_core.wrappers.turn_limit import TurnLimit


@pytest.fixture(autouse=True)
def echo_env(own_registry: registry.Registry) -> None:
    """The core's records and one environment, and an empty trace."""
    gem.register("test:Echo-v0", EchoEnv)
    TRACE.clear()


# TurnLimit and EpisodeStats.


def test_turn_limit_truncates_at_the_limit() -> None:
    """The last turn allowed is truncated, and the next one refused."""
    env = TurnLimit(EchoEnv(turns=1), 1)
    env.reset()
    assert env.step("x")[2:4] == (True, False), "the task's own end is no cut"
    env = gem.make("test:Echo-v0", wrappers=[("turn_limit", {"max_turns": 2})])
    env.reset(seed=1)
    assert [env.step("x")[2:4], env.step("x")[2:4]] == [(False, False), (False, True)]
    with pytest.raises(ResetNeededError, match=r"^test:Echo-v0"):
        env.step("x")
    env.reset()
    assert env.step("x")[3] is False


@pytest.mark.parametrize("max_turns", [0, "3", True, None])
def test_turn_limit_takes_positive_whole_numbers(max_turns: Any) -> None:
    """Anything else is refused with its value."""
    with pytest.raises(ArgumentError, match="max_turns"):
        TurnLimit(EchoEnv(), max_turns)


@pytest.mark.usefixtures("own_registry")
def test_max_turns_of_a_registration_is_the_limit_of_the_environment() -> None:
    """As Gymnasium's ``max_episode_steps``: ``make`` truncates, unless the environment takes the limit itself."""
    given: list[int] = []

    def announcing(max_turns: int = 9) -> EchoEnv:
        given.append(max_turns)
        return EchoEnv()

    gem.register("test:Any-v0", lambda **options: EchoEnv(), max_turns=2)
    gem.register("test:Own-v0", announcing, max_turns=2)
    env, own = gem.make("test:Any-v0"), gem.make("test:Own-v0")
    gem.make("test:Own-v0", max_turns=3)
    env.reset()
    assert [env.step("x")[3] for _ in range(2)] == [False, True]
    assert given == [2, 3]
    assert own.spec.kwargs == {"max_turns": 2}  # type: ignore[union-attr]


def test_episode_stats_reports_once_at_the_end() -> None:
    """Return, length and duration stand in the last info alone, and start anew with each episode."""
    env = EpisodeStats(ShortCut(EchoEnv(turns=3)))  # whose own answers are turns
    for _ in range(2):
        env.reset()
        infos = [env.step("x")[4] for _ in range(3)]
        assert [sorted(info) for info in infos] == [[], [], ["episode"]]
        assert (infos[2]["episode"]["r"], infos[2]["episode"]["l"]) == (3.0, 3)
        assert infos[2]["episode"]["t"] >= 0
    env.reset()
    assert env.step("stop")[4]["episode"]["r"] == -1.0
