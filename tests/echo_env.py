"""Environments and wrappers that note what is called, for the tests of wrappers."""

from __future__ import annotations

import asyncio
from typing import Any

import gem_core as gem
from gem_core.background import background_loop
from gem_core.env.base import AsyncEnv
from gem_core.env.wrapper import Wrapper

TRACE: list[Any] = []
"""What the hooks of a test wrote, in order."""


class EchoEnv(gem.Env):
    """Says back what it hears and ends after a number of turns."""

    def __init__(self, turns: int = 99) -> None:
        super().__init__()
        self.turns, self.turn = turns, 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.turn = 0
        TRACE.append(("reset", seed, options))
        return "hello", {}

    def step(self, action: str) -> Any:
        self.turn += 1
        TRACE.append(("step", action))
        return f"{action}{self.turn}", 1.0, self.turn >= self.turns, False, {}

    def sample_random_action(self) -> str:
        return "echo"


class ThreadEchoEnv(EchoEnv):
    """Blocks, as it says."""

    concurrency = "thread"


class AsyncEchoEnv(AsyncEnv):
    """The same as coroutines, on the loop that they find themselves on."""

    turn = 0

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        await super().reset_async(seed)
        self.turn = 0
        TRACE.append(("reset", seed, options))
        self.loop = asyncio.get_running_loop()
        return "hello", {}

    async def step_async(self, action: str) -> Any:
        assert asyncio.get_running_loop() is self.loop
        await asyncio.sleep(0)
        self.turn += 1
        TRACE.append(("step", action))
        return f"{action}{self.turn}", 1.0, self.turn >= 99, False, {}


class Noting(Wrapper):
    """Writes down every hook, and marks what goes through."""

    def __init__(self, env: Any, mark: str = "a") -> None:
        super().__init__(env)
        self.mark = mark

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> Any:
        TRACE.append((self.mark, "before_reset", seed, options))

    def after_reset(self, result: Any) -> Any:
        TRACE.append((self.mark, "after_reset"))
        return result[0] + self.mark, result[1]

    def before_step(self, action: str) -> Any:
        TRACE.append((self.mark, "before_step", action))
        return action + self.mark

    def after_step(self, action: str, result: Any) -> Any:
        TRACE.append((self.mark, "after_step", action))
        return (result[0] + self.mark, *result[1:])


class ThreadNoting(Noting):
    """The same, and blocks."""

    needs = "thread"


class AsyncNoting(Noting):
    """The same as coroutines, all on the library's loop."""

    async def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        self._check_loop()
        super().before_reset(seed, options)

    async def after_reset(self, result: Any) -> Any:
        self._check_loop()
        return super().after_reset(result)

    async def before_step(self, action: str) -> Any:
        self._check_loop()
        return super().before_step(action)

    async def after_step(self, action: str, result: Any) -> Any:
        self._check_loop()
        return super().after_step(action, result)

    def _check_loop(self) -> None:
        assert asyncio.get_running_loop() is background_loop()


class ShortCut(Wrapper):
    """Answers "stop" itself."""

    def before_step(self, action: str) -> Any:
        return ("stopped", -1.0, False, True, {}) if action.startswith("stop") else action

    def after_step(self, action: str, result: Any) -> Any:
        TRACE.append("short cut's after_step")
        return result
