"""The contract of ``Env``: seeds, random actions, and observations."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from guess_env import GuessEnv, StatelessEnv, play

import gem_core as gem
from gem_core.env.observations import as_parts, observation_from
from gem_core.errors import ArgumentError, SamplingNotSupported
from gem_core.registry import lookup as registry


@pytest.fixture(autouse=True)
def guess_env(own_registry: registry.Registry) -> None:
    """The core's records and one environment."""
    gem.register("test:Guess-v3", GuessEnv, high=20)


# Seeds.


def test_unseeded_environments_differ_and_report_their_seed() -> None:
    """Without a seed the stream comes from entropy, below 2**53, and is reported."""
    seeds = {gem.make("test:Guess-v3").reset()[1]["seed"] for _ in range(20)}
    assert len(seeds) == 20
    assert max(seeds) < 2**53


def test_bad_seed_is_refused() -> None:
    """By all that take one; a seed of NumPy is taken, and reported as JSON knows it."""
    for call in (GuessEnv().reset, gem.make("test:Guess-v3").reset, GuessEnv().seed_actions):
        with pytest.raises(ArgumentError):
            call(-1)
    _, info = gem.make("test:Guess-v3").reset(seed=np.int64(3))  # type: ignore[arg-type]
    assert json.dumps(info["seed"]) == "3"


def test_generator_before_reset_is_reproducible() -> None:
    """A generator that is used before any reset has a seed of ours, which starts the same stream."""
    env, fresh = GuessEnv(), StatelessEnv()
    draws = env.np_random.integers(0, 1000, 5).tolist()
    fresh.reset(seed=env.np_random_seed)
    assert fresh.np_random.integers(0, 1000, 5).tolist() == draws


def test_generator_from_outside_is_kept_until_the_next_reset() -> None:
    """It stays its owner's: a reset begins a stream of its own."""
    outside = np.random.Generator(np.random.PCG64(1))
    env, twin = GuessEnv(), GuessEnv()
    env.np_random = outside
    assert env.np_random is outside
    assert env.np_random_seed == -1
    state = str(outside.bit_generator.state)
    assert env.reset(seed=4) == twin.reset(seed=4)
    assert play(env) == play(twin)
    assert str(outside.bit_generator.state) == state


# Random actions.


def test_samples_follow_the_seed_of_the_episode_or_of_the_actions() -> None:
    """seed_actions changes the samples of this episode, and reset ends it."""
    env = GuessEnv(high=10**9)

    def sampled() -> list[str]:
        return [env.sample_random_action() for _ in range(3)]

    env.reset(seed=4)
    own = sampled()
    env.seed_actions(1)
    other = sampled()
    env.seed_actions(1)
    assert sampled() == other != own
    env.reset(seed=4)
    assert sampled() == own
    env.reset(seed=5)
    assert sampled() != own


def test_what_a_subclass_left_out_is_named() -> None:
    """With the method to write."""
    with pytest.raises(SamplingNotSupported, match="sample_random_action"):
        StatelessEnv().sample_random_action()
    with pytest.raises(NotImplementedError, match=r"^StatelessEnv must define step"):
        StatelessEnv().step("x")


# Observations.


PART = {"type": "text", "text": "a"}


@pytest.mark.parametrize(
    ("feedback", "suffix", "whole"),
    [
        ("a", "b", "ab"),
        ("a", [PART], [PART, PART]),
        ([PART], "", [PART]),
        ([], "", []),
        ([PART], [PART], [PART, PART]),
    ],
)
def test_observation_is_feedback_and_suffix(feedback: Any, suffix: Any, whole: Any) -> None:
    """Texts are joined; with parts on one side, both become parts."""
    assert observation_from(feedback, suffix) == whole
    assert as_parts(feedback) is not feedback  # joining never hands out the list it was given
