"""What environments around another share: attributes read from it, and calls of it in plain code or an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Coroutine, Mapping
from operator import attrgetter
from typing import Any, TypeVar, cast

from gem_core.background import in_thread, on_library_loop, run_sync
from gem_core.env.base import reset_arguments
from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv
from gem_core.env.wrapper import Wrapper, concurrency_of

T = TypeVar("T")


def of_env(name: str) -> Any:
    """Return a property that is read from the environment inside, and set there."""

    def assign(self: Any, value: Any) -> None:
        setattr(self.env, name, value)

    return property(attrgetter(f"env.{name}"), assign)


class AroundEnv:
    """Reads from the environment inside, ``env``, what every environment around another takes over from it."""

    answer_fences = of_env("answer_fences")
    answer_tags = of_env("answer_tags")
    metadata = of_env("metadata")
    render = of_env("render")
    render_mode = of_env("render_mode")


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

    async def wait(self, awaitable: Awaitable[T]) -> T:
        """Return the result of what runs on the library's loop."""
        return run_sync(awaitable)


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

    async def wait(self, awaitable: Awaitable[T]) -> T:
        """Return the result of what runs on the library's loop."""
        return await on_library_loop(awaitable)
