"""What Gymnasium's users reach for in a vector environment, in every backend."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
import pytest

import gem_core as gem
from gem_core.env.spaces import Text
from gem_core.errors import ArgumentError, ClosedError, EnvFaultError


@pytest.fixture(params=["sync", "async", pytest.param("process", marks=pytest.mark.thorough)])
def vector(request: pytest.FixtureRequest) -> Iterator[gem.VectorEnv]:
    """Three slots, of two environments; one process suffices for the cheap run, see the test below."""
    made = gem.make_vec(["toy:Countdown-v0", "toy:Echo-v0"], 3, backend=request.param, seed=1, render_mode="ansi")
    with made:
        yield made


def test_the_attributes_of_gymnasium(vector: gem.VectorEnv) -> None:
    """Before the first reset as after it."""
    for _ in range(2):
        assert vector.num_envs == 3
        assert vector.single_observation_space == vector.single_action_space == Text()
        assert vector.observation_space == vector.action_space == gymnasium.spaces.Tuple([Text(), Text(), Text()])
        assert vector.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP
        assert vector.metadata["render_modes"] == ["ansi", "human"]
        assert vector.render_mode == "ansi"
        assert vector.spec is not None
        assert vector.spec.id == "toy:Countdown-v0"
        assert not vector.closed
        vector.reset()
    vector.close()
    assert vector.closed


def test_attributes_are_read_and_set_in_every_environment(vector: gem.VectorEnv) -> None:
    """One value for each slot, or one for all, on the task where no wrapper has it."""
    assert vector.get_attr("env_id") == ("toy:Countdown-v0", "toy:Echo-v0", "toy:Countdown-v0")
    vector.set_attr("mark", [1, 2, 3])
    assert vector.get_attr("mark") == (1, 2, 3)
    vector.set_attr("mark", "all")
    vector.reset()
    assert vector.get_attr("mark") == ("all", "all", "all")


def test_methods_are_called_in_every_environment(vector: gem.VectorEnv) -> None:
    """With their arguments; what cannot be called is read, as in Gymnasium."""
    observations, _ = vector.reset()
    assert vector.render() == tuple(observations)
    assert vector.call("has_wrapper_attr", "env_id") == (True, True, True)
    assert vector.call("env_id") == vector.get_attr("env_id")


def test_what_cannot_be_asked_is_said(vector: gem.VectorEnv) -> None:
    """The same in every backend."""
    with pytest.raises(ArgumentError, match=r"slot 0.*'nonsense'"):
        vector.get_attr("nonsense")
    with pytest.raises(ArgumentError, match="'step'"):
        vector.call("step", "0")
    with pytest.raises(ArgumentError, match=r"'mark'.* 3 .*not 2"):
        vector.set_attr("mark", [1, 2])
    with pytest.raises(EnvFaultError, match=r"slot 0.*TypeError"):
        vector.call("has_wrapper_attr")
    vector.reset()
    vector.send(["0"] * 3)
    with pytest.raises(ArgumentError, match=r"recv\(\)"):
        vector.get_attr("env_id")
    vector.recv(3)
    vector.close()
    with pytest.raises(ClosedError):
        _ = vector.single_observation_space


def test_a_worker_answers_with_copies() -> None:
    """The cheap case of the backends with workers."""
    with gem.make_vec("toy:Countdown-v0", 1, backend="process", seed=1) as vector:
        vector.set_attr("mark", {"deep": [1]})
        (found,) = vector.get_attr("mark")
        found["deep"].append(2)
        assert vector.get_attr("mark") == ({"deep": [1]},)
        assert vector.single_action_space == Text()


def test_the_environment_that_was_asked_is_the_one_that_plays() -> None:
    """It is made once: what was set before the first reset is there after it."""
    made: list[Any] = []
    with gem.make_vec("toy:Countdown-v0", 2, backend="sync", seed=1) as vector:
        made += vector.get_attr("unwrapped")
        vector.reset()
        assert [id(task) for task in vector.get_attr("unwrapped")] == [id(task) for task in made]


def test_spaces_of_several_agents_are_by_agent() -> None:
    """As an environment of several agents has them."""
    with gem.make_vec("toy:Countdown-v0", 1, backend="sync") as vector:
        assert isinstance(vector.single_observation_space, Text)
    pytest.importorskip("gem_games", reason="a game for two; install plugins/gem-games")
    with gem.make_vec("game:TicTacToe-v0", 1, backend="sync") as vector:
        assert vector.single_action_space == gymnasium.spaces.Dict({"X": Text(), "O": Text()})
