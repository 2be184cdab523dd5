"""``to_aec`` and ``to_parallel``: PettingZoo's own tests, and what its agents see, earn and leave with."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_toys import AuctionEnv, CountdownEnv

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_pettingzoo import to_aec, to_parallel

pytestmark = pytest.mark.filterwarnings(
    # What PettingZoo says of every environment that is not of arrays, and of names without a number.
    "ignore:Observation is not a NumPy array",
    "ignore:Observation space for each agent probably should be",
    "ignore:Action space for each agent probably should be",
    "ignore:We recommend agents to be named",
)


class LeavingEnv(AuctionEnv):
    """An auction in which random text bids and leaves as well."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        """Take the length of a text as the bid; long texts leave."""
        return super().process_actions(
            {agent: "quit" if len(text) > 26 else str(len(text) % 10) for agent, text in actions.items()}
        )


def leaving_by_turns() -> LeavingEnv:
    return LeavingEnv(["a_0", "a_1", "a_2"], mode="sequential", rounds=40)


def leaving_at_once() -> LeavingEnv:
    return LeavingEnv(["a_0", "a_1", "a_2"], mode="parallel", rounds=40)


def native(name: str) -> Callable[[], Any]:
    def make() -> Any:
        try:
            gem.spec(name)
        except gem.GemError:
            pytest.skip(f"{name} comes with gem-games, which is not installed, or older")
        return gem.make(name)

    return make


ENVS = [
    pytest.param(CountdownEnv, id="countdown"),
    pytest.param(leaving_by_turns, id="leaving-by-turns"),
    pytest.param(leaving_at_once, id="leaving-at-once"),
    pytest.param(native("game:TicTacToe-v0"), id="tic-tac-toe"),
    pytest.param(native("game:RockPaperScissors-v0"), id="rock-paper-scissors"),
]


@pytest.fixture(scope="module")
def suite() -> Any:
    """PettingZoo's tests; it imports one of its games by a way that it deprecates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return importlib.import_module("pettingzoo.test")


@pytest.mark.parametrize("make", ENVS)
def test_aec_passes_api_test(make: Callable[[], Any], suite: Any) -> None:
    """PettingZoo's test of its AEC interface passes, agents that leave and join included."""
    suite.api_test(to_aec(make()), num_cycles=200)


@pytest.mark.parametrize("make", ENVS)
def test_aec_passes_seed_test(make: Callable[[], Any], suite: Any) -> None:
    """PettingZoo's test of seeds passes."""
    suite.seed_test(lambda: to_aec(make()), num_cycles=50)


@pytest.mark.parametrize("make", ENVS)
def test_parallel_passes_api_test(make: Callable[[], Any], suite: Any) -> None:
    """PettingZoo's test of its Parallel interface passes, also where agents act in turn."""
    suite.parallel_api_test(to_parallel(make()), num_cycles=200)


@pytest.mark.parametrize("make", ENVS)
def test_parallel_passes_seed_test(make: Callable[[], Any], suite: Any) -> None:
    """PettingZoo's test of seeds passes."""
    suite.parallel_seed_test(lambda: to_parallel(make()), num_cycles=50)


@given(st.lists(st.integers(0, 27), min_size=1, max_size=30), st.sampled_from([leaving_by_turns, leaving_at_once]))
def test_rewards_add_up(lengths: list[int], make: Callable[[], LeavingEnv]) -> None:
    """What ``last`` gives each agent on its turns, the step with None included, is its ``cumulative``."""
    env = make()
    aec = to_aec(env)
    aec.reset(seed=0)
    given_rewards = dict.fromkeys(env.possible_agents, 0.0)
    bids = iter(lengths + [27] * 3)  # whoever is left leaves in the end
    for agent in aec.agent_iter():
        _, reward, terminated, truncated, _ = aec.last()
        given_rewards[agent] += reward
        aec.step(None if terminated or truncated else "x" * next(bids, 27))
    assert given_rewards == env.cumulative


def test_agents_of_an_aec_are_asked_in_turn_and_see_their_own() -> None:
    """Those who act at once are asked one after another, each with its own observation, and only then is there news."""
    aec = to_aec(AuctionEnv(["a", "b"], mode="parallel", rounds=2))
    aec.reset(seed=5)
    assert (aec.agent_selection, *aec.last()) == ("a", "You are a. Bids: none", 0.0, False, False, {"seed": 5})
    aec.step("3")
    assert (aec.agent_selection, *aec.last()) == ("b", "You are b. Bids: none", 0.0, False, False, {"seed": 5})
    aec.step("1")
    assert aec.rewards == {"a": 2.0, "b": -2.0}
    assert (aec.agent_selection, *aec.last()) == ("a", "You are a. Bids: 3 1", 2.0, True, False, {})
    with pytest.raises(ArgumentError, match=r"^the action of 'a' must be text, not 3$"):
        aec.reset(seed=5) or aec.step(3)


def test_who_does_not_act_is_shown_what_it_saw_last() -> None:
    """In a Parallel environment of turns the others' actions are ignored, and infos say who acts."""
    parallel = to_parallel(CountdownEnv())
    observations, infos = parallel.reset(seed=1)
    assert observations["first"].startswith("The heap has ")
    assert observations["second"] == ""
    assert {agent: info["acting"] for agent, info in infos.items()} == {"first": True, "second": False}
    parallel.env.heap = 9
    observations, *_, infos = parallel.step({"first": "\\boxed{2}", "second": "\\boxed{3}"})
    assert observations["first"] != observations["second"] == "The heap has 7. Take 1, 2 or 3, as \\boxed{2}."
    assert {agent: info["acting"] for agent, info in infos.items()} == {"first": False, "second": True}
    with pytest.raises(ArgumentError, match="'second'"):
        parallel.step({"first": "\\boxed{2}"})
    with pytest.raises(ArgumentError, match="MultiAgent"):
        to_aec(gem.Env())
