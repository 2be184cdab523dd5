"""``SeatStack``: the wrappers of one seat in an environment of several agents, run by their hooks."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Coroutine, Mapping
from operator import attrgetter
from typing import Any, TypeVar, cast

from gem_core.background import in_thread
from gem_core.env.base import Env, reset_arguments
from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv
from gem_core.env.spec import EnvRecipe
from gem_core.env.wrapper import AnyEnv, Wrapper, concurrency_of
from gem_core.errors import ArgumentError, StateError
from gem_core.types import ResetResult, Response, StepResult

T = TypeVar("T")


def of_env(name: str) -> Any:
    """Return a property that is read from the environment inside."""
    return property(attrgetter(f"env.{name}"))


class SeatEnv(Env):
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

    answer_fences = of_env("answer_fences")
    answer_tags = of_env("answer_tags")
    env_id = of_env("env_id")
    metadata = of_env("metadata")
    np_random = of_env("np_random")
    np_random_seed = of_env("np_random_seed")
    render = of_env("render")
    render_mode = of_env("render_mode")

    @property
    def spec(self) -> EnvRecipe | None:  # type: ignore[override]  # read from the environment
        """What the environment was made from, with the wrappers that this seat has inside it."""
        spec = self.env.spec
        return None if spec is None else dataclasses.replace(spec, wrappers=spec.wrappers_of(self.seat))

    def sample_random_action(self) -> str:
        """Return a valid response of this seat."""
        return self.env.sample_random_action(self.seat)

    def get_state(self) -> dict[str, Any]:
        """Return the name of the seat; its environment keeps the rest."""
        return {"seat": self.seat}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Check that it is a state of this seat."""
        if not isinstance(state, Mapping) or state.get("seat") != self.seat:
            raise StateError(f"this is a state of other wrappers than those of the seat {self.seat!r}")


class SeatStack:
    """The wrappers of one seat, run by their hooks.

    Args:
        env: A ``SeatEnv`` with wrappers around it.
    """

    def __init__(self, env: AnyEnv) -> None:
        self.env = env
        self._layers = _layers(env)
        """The wrappers, outermost first."""
        self._begun = False
        """Whether the seat has had its first observation in this episode."""
        self._sent: list[str] = []
        """The response that awaits its result, as each layer was given it."""

    async def before_reset(self, seed: int | None, options: dict[str, Any] | None, calls: PlainCalls) -> None:
        """Prepare the wrappers for an episode."""
        self._begun, self._sent = False, []
        for layer in self._layers:
            await calls.hook(layer, "before_reset", seed, options)

    async def first(self, result: ResetResult, calls: PlainCalls) -> ResetResult:
        """Return the seat's first observation and info, as the wrappers pass them on."""
        self._begun = True
        for layer in reversed(self._layers):
            result = await calls.hook(layer, "after_reset", result)
        return result

    async def respond(self, action: str, calls: PlainCalls) -> str | StepResult:
        """Return the action for the environment, or the result of a wrapper that answered the response itself."""
        self._sent = []
        for layer in self._layers:
            outcome = await calls.hook(layer, "before_step", action)
            if isinstance(outcome, tuple):
                return await self._pass_on(outcome, calls)
            self._sent.append(action)
            action = outcome
        return action

    async def hear(self, result: StepResult, calls: PlainCalls) -> StepResult:
        """Return the result of a step of the environment, as the wrappers pass it on."""
        observation, reward, terminated, truncated, info = result
        if self._begun:
            return await self._pass_on(result, calls)
        if terminated or truncated:
            return result
        observation, info = await self.first((observation, info), calls)
        return observation, reward, False, False, info

    async def _pass_on(self, result: StepResult, calls: PlainCalls) -> StepResult:
        for layer, action in reversed(list(zip(self._layers, self._sent, strict=False))):
            result = await calls.hook(layer, "after_step", action, result)
        return result

    def get_state(self) -> dict[str, Any]:
        """Return the state of the wrappers, and what they wait for."""
        return {
            "begun": self._begun,
            "sent": list(map(saved_response, self._sent)),
            "wrappers": cast("Env", self.env).get_state(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore what ``get_state`` returned."""
        self._begun, self._sent = bool(state["begun"]), list(map(restored_response, state["sent"]))
        cast("Env", self.env).set_state(state["wrappers"])


class PlainCalls:
    """Calls hooks and the environment from plain code; its coroutines never wait."""

    async def hook(self, layer: Wrapper, name: str, *args: Any) -> Any:
        """Return what a hook returns."""
        return layer.run_hook(name, *args)

    async def together(self, jobs: Mapping[str, Coroutine[Any, Any, T]]) -> dict[str, T]:
        """Return the results of coroutines, by agent."""
        try:
            return {agent: await job for agent, job in jobs.items()}
        finally:
            for job in jobs.values():
                job.close()  # those behind one that failed

    async def reset(self, env: MultiAgentEnv, seed: int | None, options: dict[str, Any] | None) -> JointResetResult:
        """Reset the environment."""
        return env.reset(**reset_arguments(seed, options))

    async def step(self, env: MultiAgentEnv, actions: dict[str, str]) -> JointStepResult:
        """Step the environment."""
        return env.step(actions)

    async def truncate_all(self, env: MultiAgentEnv) -> JointStepResult:
        """End the episode."""
        return env.truncate_all()


class AwaitedCalls(PlainCalls):
    """Calls hooks and the environment from an event loop without blocking it."""

    async def hook(self, layer: Wrapper, name: str, *args: Any) -> Any:
        """Return what a hook returns."""
        return await layer.run_hook_async(name, *args)

    async def together(self, jobs: Mapping[str, Coroutine[Any, Any, T]]) -> dict[str, T]:
        """Run coroutines side by side."""
        tasks = [asyncio.ensure_future(job) for job in jobs.values()]
        try:
            return dict(zip(jobs, await asyncio.gather(*tasks), strict=True))
        finally:
            for task in tasks:
                task.cancel()  # those beside one that failed

    async def reset(self, env: MultiAgentEnv, seed: int | None, options: dict[str, Any] | None) -> JointResetResult:
        """Reset the environment."""
        return cast("JointResetResult", await env.reset_async(**reset_arguments(seed, options)))

    async def step(self, env: MultiAgentEnv, actions: dict[str, str]) -> JointStepResult:
        """Step the environment."""
        return cast("JointStepResult", await env.step_async(cast("Any", actions)))

    async def truncate_all(self, env: MultiAgentEnv) -> JointStepResult:
        """End the episode."""
        return env.truncate_all() if concurrency_of(env) == "inline" else await in_thread(env.truncate_all)


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


def saved_response(response: str) -> dict[str, Any]:
    """Return a response as plain data."""
    return {"text": str(response), **(response.reported() if isinstance(response, Response) else {})}


def restored_response(saved: Mapping[str, Any]) -> str:
    """Return the response that ``saved_response`` made plain."""
    return Response(**saved) if len(saved) > 1 else str(saved["text"])
