"""``VectorEnv.call``: what every environment is asked, in every backend."""

from __future__ import annotations

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, ClosedError, EnvFaultError


@pytest.mark.parametrize("backend", ["sync", "async", "process"])
def test_every_environment_is_asked(backend: str) -> None:
    """For the result of a method, or for an attribute, before the first reset and after it; or it is said why not."""
    with gem.make_vec(["toy:Countdown-v0", "toy:Echo-v0"], 3, backend=backend, seed=1, render_mode="ansi") as vector:
        assert vector.call("env_id") == ("toy:Countdown-v0", "toy:Echo-v0", "toy:Countdown-v0")
        observations, _ = vector.reset()
        assert vector.render() == tuple(observations)
        assert vector.call("has_wrapper_attr", "env_id") == (True, True, True)
        with pytest.raises(ArgumentError, match=r"slot 0.*'nonsense'"):
            vector.call("nonsense")
        with pytest.raises(ArgumentError, match="'step'"):
            vector.call("step", "0")
        with pytest.raises(EnvFaultError, match=r"slot 0.*TypeError"):
            vector.call("has_wrapper_attr")
        vector.send(["0"] * 3)
        with pytest.raises(ArgumentError, match=r"recv\(\)"):
            vector.call("env_id")
        vector.recv(3)
    with pytest.raises(ClosedError):
        vector.call("env_id")


def test_the_environment_that_was_asked_is_the_one_that_plays() -> None:
    """It is made once."""
    with gem.make_vec("toy:Countdown-v0", 2, backend="sync", seed=1) as vector:
        made = vector.call("unwrapped")
        vector.reset()
        assert [id(task) for task in vector.call("unwrapped")] == [id(task) for task in made]
