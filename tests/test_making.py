"""Made environments: render modes, specifications, and life among Gymnasium's wrappers."""

from __future__ import annotations

import copy
import inspect
import json
import warnings
from typing import Any, Unpack

import gymnasium
import pytest
from guess_env import GuessEnv
from gymnasium import wrappers as gym_wrappers
from gymnasium.utils.env_checker import check_env

import gem_core as gem
from gem_core.arguments import signature_of
from gem_core.data import DatasetOptions
from gem_core.errors import ArgumentError, UnknownWrapperError
from gem_core.making.again import Recipe
from gem_core.making.environment import wrap
from gem_core.registry import lookup as registry


@pytest.fixture(autouse=True)
def guess_env(own_registry: registry.Registry) -> None:
    """The core's records and one environment."""
    gem.register("test:Guess-v3", GuessEnv, high=20)


# Making.


def test_render_mode_is_handled_by_make() -> None:
    """render_mode works for a constructor that knows nothing of it; one that there is not gives those there are."""
    env = gem.make("test:Guess-v3", render_mode="ansi")
    env.reset(seed=1)
    assert (env.render_mode, env.render()) == ("ansi", "turn 0")
    with pytest.raises(ArgumentError, match=r"no render mode 'rgb_array'; .*'ansi', 'human'"):
        gem.make("test:Guess-v3", render_mode="rgb_array")


def test_specification_makes_the_same_again() -> None:
    """With arguments, render mode and wrappers; ``make`` takes it too, and more goes around."""
    env = gem.make(
        "test:Guess-v3", wrappers=["episode_stats", ("turn_limit", {"max_turns": 2})], render_mode="ansi", high=7
    )
    again = env.spec.make()  # type: ignore[union-attr]
    assert (str(again), again.spec) == (str(env), env.spec)
    assert (again.unwrapped.high, again.render_mode, again.get_wrapper_attr("max_turns")) == (7, "ansi", 2)
    more = gem.make(env.spec, wrappers="latest", high=5)  # type: ignore[arg-type]  # it has one
    assert more.spec.wrappers == (*env.spec.wrappers, ("latest", {}))  # type: ignore[union-attr]
    assert more.unwrapped.high == 5


def test_specification_does_not_make_wrappers_of_gymnasium() -> None:
    """It says so, in place of an environment without them."""
    env: Any = gym_wrappers.TimeLimit(gem.make("test:Guess-v3", wrappers="episode_stats"), 4)
    for wrapped in env, wrap(env, "latest"):
        with pytest.raises(ArgumentError, match="Gymnasium"):
            wrapped.spec.make()


def test_specification_goes_through_json() -> None:
    """What is recorded, as JSON, makes the same stack; a copy shares the arguments, such as rows."""
    env = gem.make("test:Guess-v3", wrappers=[("turn_limit", {"max_turns": 2}), "episode_stats"], turns=4)
    assert copy.deepcopy(env.spec).kwargs is env.spec.kwargs  # type: ignore[union-attr]
    recorded = json.loads(json.dumps(env.spec.recorded()))
    again = gem.make(recorded["id"], wrappers=recorded["wrappers"], **recorded["kwargs"])
    assert again.spec == env.spec
    assert str(again) == str(env)


# Life with Gymnasium.


def test_gymnasium_checker_passes() -> None:
    """Gymnasium's own checker finds nothing to say."""
    check_env(gem.make("test:Guess-v3", render_mode="ansi").unwrapped)


GYM_WRAPPERS = [
    lambda env: gym_wrappers.TimeLimit(env, 3),
    gym_wrappers.RecordEpisodeStatistics,
    lambda env: gym_wrappers.TransformReward(env, lambda reward: reward - 1),
    gym_wrappers.PassiveEnvChecker,
    gym_wrappers.Autoreset,
    lambda env: gym_wrappers.TransformObservation(env, str.upper, env.observation_space),
]


@pytest.mark.parametrize("put", GYM_WRAPPERS)
def test_wrapper_of_gymnasium_runs(put: Any) -> None:
    """Gymnasium's wrappers play whole episodes, and GEM's methods are reached through them."""
    env = put(gem.make("test:Guess-v3"))
    observation, _ = env.reset(seed=1)
    assert observation.upper() == "GUESS A NUMBER FROM 1 TO 20."
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(env.get_wrapper_attr("sample_random_action")())
        over = terminated or truncated
    assert isinstance(env.unwrapped, GuessEnv)
    assert env.get_wrapper_attr("env_id") == "test:Guess-v3"
    assert info["correct"] in (True, False)


def test_vector_environment_of_gymnasium_runs() -> None:
    """Gymnasium's SyncVectorEnv steps made environments."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        vector = gymnasium.vector.SyncVectorEnv([lambda: gem.make("test:Guess-v3")] * 2)
    assert list(vector.reset(seed=[1, 2])[1]["seed"]) == [1, 2]
    assert vector.step(["0", "0"])[1].tolist() == [0.0, 0.0]
    vector.close()


def test_reset_that_forgets_its_info_is_named() -> None:
    """A newcomer's first mistake gets a clear message."""

    class Forgetful(GuessEnv):
        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            return super().reset(seed)[0]

    gem.register("test:Forgetful-v0", Forgetful)
    with pytest.raises(TypeError, match=r"Forgetful: reset must return \(observation, info\), not 'Guess a number"):
        gem.make("test:Forgetful-v0").reset(seed=1)


def test_environment_is_closed_when_its_wrappers_cannot_be_made() -> None:
    """What its constructor started is not left behind by a misspelt name."""
    closed: list[str] = []

    class Started(GuessEnv):
        def close(self) -> None:
            closed.append("it")

    gem.register("toy:Started-v0", Started)
    with pytest.raises(UnknownWrapperError):
        gem.make("toy:Started-v0", wrappers="concatt")
    assert closed == ["it"]


class TwiceEnv(gem.DatasetEnv):
    """Adds a keyword to those of its base."""

    def __init__(self, rows: Any = None, *, twice: bool = False, **options: Unpack[DatasetOptions]) -> None:
        super().__init__(rows, **options)
        self.twice = twice


def test_keywords_that_are_handed_on_are_named() -> None:
    """``**options: Unpack[…]`` stands for the keywords of the base, with their types and defaults."""
    signature = signature_of(TwiceEnv)
    assert signature is not None
    assert list(signature.parameters)[:3] == ["rows", "twice", "dataset_name"]
    assert str(signature.parameters["question_key"]) == "question_key: 'str' = 'question'"
    assert signature.parameters["split"].kind is inspect.Parameter.KEYWORD_ONLY
    env = TwiceEnv([{"q": "a", "answer": "b"}], question_key="q", twice=True)
    assert Recipe.of(env).make(id_key="q").reset()[1]["task_id"] == "a"
    with pytest.raises(ArgumentError, match=r"Did you mean 'question_key'\? It accepts: rows, twice, dataset_name"):
        Recipe.of(env).make(question_kye="q")


@pytest.mark.parametrize(
    "wrappers", ["concat:max_turns=2,episode_stats", ["concat:max_turns=2", ("episode_stats", {})]]
)
def test_wrappers_are_named_as_on_the_command_line(wrappers: Any) -> None:
    """Options stand behind a colon, in Python too."""
    env = gem.make("test:Guess-v3", wrappers=wrappers)
    assert env.spec.wrappers == (("concat", {"max_turns": 2}), ("episode_stats", {}))  # type: ignore[union-attr]
