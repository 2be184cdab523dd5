"""Environments of several agents in vector environments: every backend, autoreset, faults and refused actions."""

from __future__ import annotations

from typing import Any

import pytest
from joint_toys import CountdownEnv

import gem_core as gem
from gem_core import VectorEnv
from gem_core.errors import ArgumentError

BACKENDS = ["sync", "process"]


@pytest.fixture(autouse=True)
def _registered() -> None:
    for record in (
        gem.EnvSpec(id="jointvec:Countdown-v0", entry_point="joint_toys:CountdownEnv", seats=("first", "second")),
        gem.EnvSpec(id="jointvec:Broken-v0", entry_point="joint_toys:BrokenAuctionEnv", seats=("a", "b")),
        gem.EnvSpec(id="jointvec:Word-v0", entry_point="word_env:WordEnv"),
    ):
        if record.id not in gem.list_envs("jointvec"):
            gem.register(record.id, record.entry_point, seats=record.seats)


def acted(vector: VectorEnv, observations: list[Any]) -> list[Any]:
    """Return a valid random action of each agent that acts in each slot."""
    return [
        {agent: vector.sample_random_action(slot, agent) for agent in observation}
        for slot, observation in enumerate(observations)
    ]


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_gives_the_same_episodes(backend: str) -> None:
    """Observations, rewards, flags and infos of 30 steps are those of the environments alone, episode by episode."""
    with gem.make_vec("jointvec:Countdown-v0", 3, backend=backend, seed=4) as vector:
        alone: list[Any] = [CountdownEnv() for _ in range(3)]
        observations, infos = vector.reset()
        for env, observation, info in zip(alone, observations, infos, strict=True):
            assert observation == env.reset(seed=info["seed"])[0]
            assert info["possible_agents"] == ["first", "second"]
        for _ in range(30):
            actions = acted(vector, observations)
            observations, rewards, terminated, truncated, infos = vector.step(actions)
            assert not any(truncated)
            for slot, env in enumerate(alone):
                expected = env.step(actions[slot])
                info = infos[slot]
                assert rewards[slot] == expected[1]
                if not terminated[slot]:
                    assert (observations[slot], info["agents"]) == (expected[0], expected[4])
                    continue
                assert info["final_info"]["agents"] == expected[4]
                assert info["final_info"]["terminations"] == {"first": True, "second": True}
                assert observations[slot] == env.reset(seed=info["seed"])[0]


def test_random_actions_of_a_seat_are_its_own() -> None:
    """What a seat draws does not depend on what others drew before, so the order of asking decides nothing."""
    drawn = []
    for order in (["first", "second"], ["second", "first"]):
        with gem.make_vec("jointvec:Countdown-v0", 1, backend="sync", seed=1) as vector:
            vector.reset()
            with pytest.raises(ArgumentError, match=r"slot 0.*'first'"):
                vector.sample_random_action(0)
            drawn.append({agent: [vector.sample_random_action(0, agent) for _ in range(5)] for agent in order})
    assert drawn[0] == drawn[1]
    assert drawn[0]["first"] != drawn[0]["second"]


def test_both_kinds_go_together() -> None:
    """One batch holds environments of one agent and of several."""
    with gem.make_vec(["jointvec:Countdown-v0", "jointvec:Word-v0"], backend="sync", seed=1) as vector:
        observations, _ = vector.reset()
        assert isinstance(observations[0], dict)
        assert isinstance(observations[1], str)
        _, rewards, terminated, _, infos = vector.step([{"first": "\\boxed{1}"}, "hello"])
        assert rewards[0] == {"second": 0.0}
        assert isinstance(rewards[1], float)
        assert list(terminated[:1]) == [False]
        assert infos[0]["agents"].keys() == {"second"}


@pytest.mark.parametrize(
    "action",
    [{"second": "1"}, "1", {"first": 1}],
)
def test_wrong_action_is_refused_before_the_step(action: Any) -> None:
    """A missing or unwanted action is an error of the caller, and never a fault of the environment."""
    with gem.make_vec(["jointvec:Countdown-v0", "jointvec:Word-v0"], backend="sync", seed=1) as vector:
        vector.reset()
        with pytest.raises(ArgumentError, match="slot 0"):
            vector.step([action, "hello"])
        with pytest.raises(ArgumentError, match="slot 1"):
            vector.step([{"first": "1"}, {"first": "1"}])
        assert vector.faults == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_environment_that_fails_is_replaced(backend: str) -> None:
    """A failing step ends the episode of everybody with an error, and the next episode begins."""
    with gem.make_vec("jointvec:Broken-v0", 1, backend=backend, seed=1) as vector:
        observations, _ = vector.reset()
        observations, rewards, _, truncated, infos = vector.step([dict.fromkeys(observations[0], "boom")])
        assert (rewards[0], bool(truncated[0])) == ({}, True)
        assert infos[0]["final_info"]["error"]["message"] == "step raised ValueError: boom"
        assert observations[0].keys() == {"a"}
        assert vector.faults == 1
