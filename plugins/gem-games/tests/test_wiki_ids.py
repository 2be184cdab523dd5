"""The ids of WikiGame: what they promise, and that their games can be won."""

from __future__ import annotations

import re
import time
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import AgentError
from gem_core.testing import check_env
from gem_games.wiki.agent import WikiGameAgent
from gem_games.wiki_game import VARIANTS

PARAMETERS: dict[str, dict[str, Any]] = {
    "game:WikiGame-v0-easy": {"max_turns": 30, "min_distance": 2, "max_distance": 3},
    "game:WikiGame-v0-hard": {"max_turns": 15, "min_distance": 4, "max_distance": 6},
    "game:WikiGame-v0-random": {"max_turns": None, "min_distance": 2, "max_distance": 9},
}
IDS = list(PARAMETERS)
HOSTILE = [
    "",
    "\\boxed{}",
    "\\boxed{   }",
    "\\boxed{\x00}",
    "\\boxed{\ud800}",
    "\\boxed{" * 5_000,
    "\\boxed{<LINKS 0>}",
    "\\boxed{<LINKS 999999999999999999>}",
    "\\boxed{<LINKS" + " " * 1_000_000 + "2>}",
    "x" * 5_000_000,
    "\\boxed{" + "x_" * 2_500_000 + "}",
]


def test_registered_ids_and_parameters() -> None:
    assert {env_id: dict(gem.spec(env_id).kwargs) for env_id in IDS} == PARAMETERS


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_keeps_the_contract(variant: str) -> None:
    check_env(gem.make("game:WikiGame-v0-random", variant=variant))


@pytest.mark.parametrize("env_id", IDS)
def test_solver_wins_many_games(env_id: str, many: int) -> None:
    """In as many turns as the start is links away from the target, whatever the variant."""
    agent, envs = WikiGameAgent(), [gem.make(env_id, variant=variant) for variant in VARIANTS]
    for seed in range(many):
        env = envs[seed % len(envs)]
        observation, _ = env.reset(seed=seed)
        total, over, info = 0.0, False, dict[str, Any]()
        while not over:
            observation, reward, over, _, info = env.step(agent(observation))
            total += reward
        assert info["correct"], seed
        assert env.unwrapped.turn == env.unwrapped.distance <= env.unwrapped.max_turns
        assert total == pytest.approx(1 - 0.05 * (env.unwrapped.distance - 1))


@pytest.mark.parametrize("wrappers", ["concat", "concat_with_action", "messages"])
def test_solver_reads_a_history(wrappers: str) -> None:
    env, agent = gem.make(IDS[0], wrappers=wrappers), WikiGameAgent()
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        info: dict[str, Any] = {}
        while "correct" not in info:
            observation, _, _, _, info = env.step(agent(observation))
        assert info["correct"]


def test_solver_refuses_what_it_does_not_know() -> None:
    guess, _ = gem.make("game:GuessTheNumber-v0").reset(seed=0)
    with pytest.raises(AgentError, match=r"agent 'wikigame' plays game:WikiGame-\*"):
        WikiGameAgent()(guess)
    observation, _ = gem.make("game:WikiGame-v0-easy").reset(seed=0)
    with pytest.raises(AgentError, match=r"^agent 'wikigame' knows the embedded articles alone: there is no embedded"):
        WikiGameAgent()(observation.replace("You are at: ", "You are at: Mount "))


def test_distances_and_turns_of_the_ids() -> None:
    seen: dict[str, set[tuple[int, int]]] = {}
    for env_id in IDS:
        env = gem.make(env_id)
        for seed in range(400):
            env.reset(seed=seed)
            seen.setdefault(env_id[len("game:WikiGame-v0-") :], set()).add((env.max_turns, env.distance))
    assert seen["easy"] == {(30, 2), (30, 3)}
    assert seen["hard"] == {(15, 4), (15, 5), (15, 6)}
    assert seen["random"] >= {(turns, distance) for turns in (15, 30) for distance in (2, 3, 4, 5, 6)}


@pytest.mark.parametrize("variant", VARIANTS)
def test_random_actions_are_valid(variant: str) -> None:
    env = gem.make("game:WikiGame-v0-random", variant=variant)
    for seed in range(50):
        env.reset(seed=seed)
        over = False
        while not over:
            observation, _, over, _, info = env.step(env.sample_random_action())
            assert info["parsed_action"] is not None
            assert observation == info["feedback"] + info["suffix"]
        assert re.fullmatch(r"\\boxed\{.+\}", env.sample_random_action())


@pytest.mark.parametrize("variant", VARIANTS)
def test_hostile_responses_are_answered_fast_and_briefly(variant: str) -> None:
    env = gem.make("game:WikiGame-v0-easy", variant=variant)
    for response in HOSTILE:
        env.reset(seed=0)
        started = time.perf_counter()
        observation, reward, terminated, *_ = env.step(response)
        assert time.perf_counter() - started < 5, response[:40]
        assert len(observation) < 1_500
        assert observation.encode()
        assert (reward, terminated) == (-0.2, False)


def test_agent_is_registered() -> None:
    from gem_core.registry import registry

    assert registry().agent("wikigame").entry_point == "gem_games.wiki.agent:WikiGameAgent"
