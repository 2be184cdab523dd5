"""The contract of ``Env``: seeds, state, siblings, and life among Gymnasium's wrappers."""

from __future__ import annotations

import copy
import json
import pickle
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


def test_seed_by_position_and_by_keyword() -> None:
    """Reset takes the seed either way."""
    first, second = GuessEnv(), GuessEnv()
    first.reset(4)
    second.reset(seed=4)
    assert play(first) == play(second)


def test_stream_continues_with_other_episodes() -> None:
    """Later resets give the next episodes of the stream, the same each time."""

    def episodes() -> list[Any]:
        env = gem.make("test:Guess-v3")
        return [env.reset(seed=4), play(env), *((env.reset(), play(env)) for _ in range(3))]

    assert episodes() == episodes()
    assert len({str(episode) for episode in episodes()}) == 5


def test_reported_seed_replays_an_episode_alone() -> None:
    """info["seed"] of any episode starts the same episode in another instance."""
    env = gem.make("test:Guess-v3")
    env.reset(seed=4)
    _, info = env.reset()
    other = gem.make("test:Guess-v3")
    other.reset(seed=info["seed"])
    assert play(env) == play(other)


def test_unseeded_environments_differ_and_report_their_seed() -> None:
    """Without a seed the stream comes from entropy, below 2**53, and is reported."""
    seeds = {gem.make("test:Guess-v3").reset()[1]["seed"] for _ in range(20)}
    assert len(seeds) == 20
    assert max(seeds) < 2**53


@pytest.mark.parametrize("seed", [-1, True, 1.5, "x"])
def test_bad_seed_is_refused(seed: Any) -> None:
    """Reset and seed_actions take whole numbers from 0 up."""
    text = f"seed must be a whole number from 0 up, not {seed!r}"
    for call in (GuessEnv().reset, gem.make("test:Guess-v3").reset, GuessEnv().seed_actions):
        with pytest.raises(ArgumentError) as caught:
            call(seed)
        assert str(caught.value) == text


def test_seed_without_end_is_refused() -> None:
    """A number that could not even be printed."""
    with pytest.raises(ArgumentError, match=r"seed must be below 2\*\*128"):
        GuessEnv().reset(seed=10**5000)


def test_numpy_seed_is_reported_as_int() -> None:
    """A seed of NumPy is taken, and reported as JSON knows it."""
    _, info = gem.make("test:Guess-v3").reset(seed=np.int64(3))  # type: ignore[arg-type]
    assert json.dumps(info["seed"]) == "3"


def test_global_randomness_is_left_alone() -> None:
    """No reset, step or sample draws from, or changes, NumPy's global generator."""
    before = np.random.get_state()[1].tolist()  # type: ignore[index,union-attr]
    env = gem.make("test:Guess-v3")
    env.reset()
    env.step(env.sample_random_action())
    assert np.random.get_state()[1].tolist() == before  # type: ignore[index,union-attr]


def test_generator_before_reset_is_reproducible() -> None:
    """A generator that is used before any reset has a seed of ours, which starts the same stream."""
    env = GuessEnv()
    seed = env.np_random_seed
    draws = env.np_random.integers(0, 1000, 5).tolist()
    assert seed < 2**53
    fresh = StatelessEnv()
    fresh.reset(seed=seed)
    assert fresh.np_random.integers(0, 1000, 5).tolist() == draws


@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.MT19937])
def test_generator_from_outside_is_never_started_in_place(bits: Any) -> None:
    """A generator that was set from outside stays its owner's at the next reset, whatever its kind."""
    outside = np.random.Generator(bits(1))
    env, twin = GuessEnv(), GuessEnv()
    env.np_random = outside
    assert env.np_random is outside
    assert env.np_random_seed == -1
    state = str(outside.bit_generator.state)
    env.reset(seed=4)
    twin.reset(seed=4)
    assert str(outside.bit_generator.state) == state
    assert play(env) == play(twin)


# Random actions.


def test_sampling_does_not_change_the_episode() -> None:
    """Any number of sampled actions leaves the dynamics as they were."""
    first, second = GuessEnv(), GuessEnv()
    first.reset(seed=4)
    second.reset(seed=4)
    for _ in range(10):
        first.sample_random_action()
    assert play(first) == play(second)


def test_sampling_follows_the_seed() -> None:
    """The same episode samples the same actions, another one others."""

    def sample(seed: int) -> list[str]:
        env = GuessEnv(high=10**9)
        env.reset(seed=seed)
        return [env.sample_random_action() for _ in range(5)]

    assert sample(4) == sample(4) != sample(5)


def test_actions_are_reseeded_for_one_episode() -> None:
    """seed_actions changes the samples of this episode, and reset ends it."""
    env = GuessEnv(high=10**9)
    env.reset(seed=4)
    own = env.sample_random_action()
    env.seed_actions(1)
    other = env.sample_random_action()
    env.seed_actions(1)
    assert env.sample_random_action() == other != own
    env.reset(seed=4)
    assert env.sample_random_action() == own


def test_sampling_unsupported_says_what_to_override() -> None:
    """An environment that does not say what is valid raises with the method to write."""
    with pytest.raises(SamplingNotSupported) as caught:
        StatelessEnv().sample_random_action()
    assert str(caught.value) == ("StatelessEnv does not say what a valid action is; override sample_random_action")


# Copies.


def test_fork_through_make_goes_on_the_same() -> None:
    """A sibling in the same state gives the same results, and does not touch its original."""
    env = gem.make("test:Guess-v3")
    env.reset(seed=4)
    play(env, 1)
    sibling = env.fork()
    assert play(sibling) == play(env)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("make", [GuessEnv, lambda: gem.make("test:Guess-v3", wrappers="episode_stats")])
def test_copies_go_on_the_same(make: Any, duplicate: Any) -> None:
    """A copied or pickled environment, bare or made, goes on as its original and apart from it."""
    env = make()
    env.reset(seed=4)
    play(env, 1)
    again = duplicate(env)
    expected = [step[:4] for step in play(again)]
    assert [step[:4] for step in play(env)] == expected
    assert again.spec == env.spec


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


def test_parts_are_a_new_list() -> None:
    """Joining never hands out the list it was given."""
    parts = [PART]
    assert as_parts(parts) is not parts


def test_missing_step_names_the_class() -> None:
    """A subclass without step says so."""
    with pytest.raises(NotImplementedError, match=r"^StatelessEnv must define step\(self, action\)$"):
        StatelessEnv().step("x")
