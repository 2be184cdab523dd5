"""The render modes ``"ansi"`` and ``"human"``: a text of the state, returned or printed."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from guess_env import GuessEnv
from joint_toys import CountdownEnv

import gem_core as gem
from gem_core.registry import lookup as registry


class Shout(gem.Env):
    """Draws nothing: its observation is all that there is."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return "Say something.", {}

    def step(self, action: str) -> Any:
        return f"You said {action}\x07", 0.0, False, False, {}


class Stage(CountdownEnv):
    """A game for two that draws itself."""

    metadata = {"render_modes": ["ansi", "human"]}  # noqa: RUF012 - as in Gymnasium

    def render(self) -> str | None:
        return None if self.render_mode is None else f"{', '.join(self.acting) or 'nobody'} to take"


@pytest.fixture(autouse=True)
def envs(own_registry: registry.Registry) -> None:
    """The core's records and three environments."""
    gem.register("test:Guess-v3", GuessEnv, high=20)
    gem.register("test:Shout-v0", Shout)
    gem.register("test:Stage-v0", Stage, seats=("first", "second"))


def test_ansi_returns_the_drawing_of_the_task_inside_any_wrapper() -> None:
    """And nothing is printed."""
    env = gem.make("test:Guess-v3", render_mode="ansi", wrappers="concat")
    env.reset(seed=1)
    env.step("3")
    assert (env.render_mode, env.render()) == ("ansi", "turn 1")


def test_a_task_that_draws_nothing_is_shown_by_its_last_observation() -> None:
    """As it came from the task, whatever a view makes of it."""
    assert gem.make("test:Shout-v0").render() is None
    env = gem.make("test:Shout-v0", render_mode="ansi", wrappers="concat")
    env.reset(seed=1)
    assert env.render() == "Say something."
    env.step("hello")
    assert env.render() == "You said hello\x07"


def test_human_prints_on_reset_and_step(capsys: pytest.CaptureFixture[str]) -> None:
    """As Gymnasium does; ``render`` returns None then. Control characters are made visible."""
    env: Any = gem.make("test:Shout-v0", render_mode="human")
    env.reset(seed=1)
    env.step("hello")
    assert (env.render_mode, env.render()) == ("human", None)
    assert capsys.readouterr().out == "Say something.\nYou said hello\\x07\n"

    async def in_a_loop() -> None:
        await env.reset_async(1)
        await env.step_async("hello")

    asyncio.run(in_a_loop())
    assert capsys.readouterr().out == "Say something.\nYou said hello\\x07\n"


def test_human_prints_the_drawing_of_several_agents(capsys: pytest.CaptureFixture[str]) -> None:
    """On reset and step, as of one agent."""
    env: Any = gem.make("test:Stage-v0", render_mode="human")
    observations, _ = env.reset(seed=1)
    env.step(dict.fromkeys(observations, "\\boxed{1}"))
    assert [line.rpartition(" to ")[2] for line in capsys.readouterr().out.splitlines()] == ["take", "take"]
