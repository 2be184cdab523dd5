"""``SeatStack``: the wrappers of one seat in an environment of several agents, run by their hooks."""

from __future__ import annotations

import dataclasses
from typing import Any

from gem_core.env.base import Env
from gem_core.env.joint_calls import AroundEnv, PlainCalls, of_env
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.types import ResetResult, StepResult


class SeatEnv(AroundEnv, Env):
    """What the wrappers of a seat see of the environment; they are run by their hooks, so it is never stepped.

    Args:
        env: The environment.
        seat: Name of the agent.
    """

    def __init__(self, env: MultiAgentEnv, seat: str) -> None:
        super().__init__()
        self.env, self.seat = env, seat
        self.observation_space = env.observation_space(seat)
        self.action_space = env.action_space(seat)

    env_id = of_env("env_id")
    np_random = of_env("np_random")
    np_random_seed = of_env("np_random_seed")

    @property
    def spec(self) -> Any:  # type: ignore[override]  # read from the environment
        """What the environment was made from, with the wrappers that this seat has inside it."""
        spec = self.env.spec
        return None if spec is None else dataclasses.replace(spec, wrappers=spec.wrappers_of(self.seat))

    def sample_random_action(self) -> str:
        """Return a valid response of this seat."""
        return self.env.sample_random_action(self.seat)

    def gold_action(self) -> str | None:
        """Return a response by which the task of this seat is solved."""
        return self.env.gold_action(self.seat)


class SeatStack:
    """The wrappers of one seat, run by their hooks.

    Args:
        env: A ``SeatEnv`` with wrappers around it.
    """

    def __init__(self, env: AnyEnv) -> None:
        self.env = env
        self._layers = _layers(env)
        """The wrappers, outermost first."""
        self._sent: list[str] | None = None
        """The response that awaits its result, as each layer was given it, outermost first; None where none does."""

    async def before_reset(self, seed: int | None, options: dict[str, Any] | None, calls: PlainCalls) -> None:
        """Prepare the wrappers for an episode."""
        self._sent = None
        for layer in self._layers:
            await calls.hook(layer, "before_reset", seed, options)

    async def first(self, result: ResetResult, calls: PlainCalls) -> ResetResult:
        """Return the seat's first observation and info, as the wrappers pass them on."""
        for layer in reversed(self._layers):
            result = await calls.hook(layer, "after_reset", result)
        return result

    async def respond(self, action: str, calls: PlainCalls) -> str | StepResult:
        """Return the action for the environment, or the result of a wrapper that answered the response itself."""
        sent: list[str] = []
        for layer in self._layers:
            outcome = await calls.hook(layer, "before_step", action)
            if isinstance(outcome, tuple):
                return await self._pass_on(sent, outcome, calls)
            sent.append(action)
            action = outcome
        self._sent = sent
        return action

    async def hear(self, result: StepResult, calls: PlainCalls) -> StepResult:
        """Return the result of a step of the environment, as the wrappers pass it on.

        Where the seat ended and had sent no response, the result is returned unchanged.
        """
        observation, reward, terminated, truncated, info = result
        if self._sent is not None:
            sent, self._sent = self._sent, None
            return await self._pass_on(sent, result, calls)
        if terminated or truncated:
            return result
        observation, info = await self.first((observation, info), calls)
        return observation, reward, False, False, info

    async def _pass_on(self, sent: list[str], result: StepResult, calls: PlainCalls) -> StepResult:
        for layer, action in reversed(list(zip(self._layers, sent, strict=False))):
            result = await calls.hook(layer, "after_step", action, result)
        return result


_METHODS = ("reset", "step", "reset_async", "step_async")


def _layers(env: AnyEnv) -> list[Wrapper]:
    """Return the wrappers of a seat, outermost first.

    Raises:
        ArgumentError: One is not made from hooks alone.
    """
    layers = []
    while not isinstance(env, SeatEnv):
        if not isinstance(env, Wrapper) or any(
            getattr(type(env), name) is not getattr(Wrapper, name) for name in _METHODS
        ):
            raise ArgumentError(
                f"{type(env).__name__} cannot go around a seat, since it is not made from hooks alone: derive it from "
                "gem_core.Wrapper and override before_reset, after_reset, before_step or after_step; or put it around "
                "gem_core.single_agent(env, seat, others)"
            )
        layers.append(env)
        env = env.env
    return layers
