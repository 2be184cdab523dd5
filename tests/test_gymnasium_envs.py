"""Environments of GEM by ``gymnasium.make``."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import pytest
from distributions import python
from gymnasium.utils.env_checker import check_env

import gem_core as gem
import gem_core.gymnasium_envs
from gem_core.errors import ArgumentError
from gem_core.gymnasium_envs import gymnasium_id
from gem_core.making.again import Recipe

COUNTDOWN = "GEM/toy.Countdown-v0"


@pytest.fixture(autouse=True)
def registered() -> None:
    """The toys are in Gymnasium's table, though they were registered after the module was imported."""
    gem_core.gymnasium_envs.register()


def test_importing_the_module_is_all_that_is_needed() -> None:
    """By Gymnasium's own way, in which an id names the module."""
    pytest.importorskip("gem_games", reason="it makes a game; install plugins/gem-games")
    code = (
        "import gymnasium, sys; print([name for name in sys.modules if name.startswith('gem_')])\n"
        "print(gymnasium.make('gem_core.gymnasium_envs:GEM/game.Sudoku-v0-easy').spec.id)"
    )
    done = python(code, [])
    assert (done.stdout, done.stderr) == ("[]\nGEM/game.Sudoku-v0-easy\n", "")


def test_an_episode_is_that_of_gem_without_a_warning() -> None:
    """Gymnasium's two checkers and its order enforcer find nothing to say, in any render mode."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(COUNTDOWN).unwrapped)
        theirs = gymnasium.make(COUNTDOWN, render_mode="ansi")
        ours = gem.make("toy:Countdown-v0")
        assert theirs.reset(seed=3) == ours.reset(seed=3)
        action = ours.get_wrapper_attr("sample_random_action")()
        assert theirs.unwrapped.sample_random_action() == action  # type: ignore[attr-defined]
        assert theirs.step(action) == ours.step(action)
        assert isinstance(theirs.render(), str)


def test_arguments_wrappers_and_limits_pass_through() -> None:
    """Those of the environment and of ``gem.make`` inwards, Gymnasium's own to Gymnasium."""
    env = gymnasium.make(COUNTDOWN, longest=9, wrappers="concat", max_episode_steps=1)
    assert env.spec is not None
    assert env.spec.kwargs == {"gem_id": "toy:Countdown-v0", "longest": 9, "wrappers": "concat"}
    env.reset(seed=1)
    assert env.step("nothing")[2:4] == (False, True)
    with pytest.raises(ArgumentError, match="got an unexpected keyword argument 'shortest'"):
        gymnasium.make(COUNTDOWN, shortest=1)


def test_the_spec_is_gymnasiums_and_makes_the_same_again() -> None:
    """Also as JSON, and by its recipe."""
    env: Any = gymnasium.make(COUNTDOWN, longest=9)
    assert env.spec.id == COUNTDOWN
    for again in gymnasium.make(type(env.spec).from_json(env.spec.to_json())), Recipe.of(env).make():
        assert again.spec == env.spec
        assert again.reset(seed=5) == env.reset(seed=5)
    assert gymnasium.spec(COUNTDOWN).nondeterministic is False


def test_several_at_once() -> None:
    """Gymnasium's vector environments write into the metadata of what they are given."""
    before = dict(gem.Env.metadata)
    gymnasium.make_vec(COUNTDOWN, num_envs=2).close()
    assert gem.Env.metadata == before


def test_every_id_has_one_of_its_own_in_gymnasium() -> None:
    """No two map to the same; those of several agents are left out."""
    records = [gem.spec(env_id) for env_id in gem.list_envs()]
    alone = [record.id for record in records if not record.seats]
    assert len({gymnasium_id(env_id) for env_id in alone}) == len(alone)
    assert {gymnasium_id(env_id) for env_id in alone} <= set(gymnasium.registry)
    assert not {gymnasium_id(record.id) for record in records if record.seats} & set(gymnasium.registry)


def test_a_rollout_says_what_it_needs() -> None:
    """A record holds what ``gem.make`` was given."""
    with pytest.raises(ArgumentError, match=r"gymnasium\.make"):
        list(gem.rollout(gymnasium.make(COUNTDOWN), "random", episodes=1))
