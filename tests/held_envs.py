"""Environments of every kind that can be held up from outside, for tests of who waits for whom."""

from __future__ import annotations

import asyncio
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

from toys import CountdownEnv

import gem_core as gem
from gem_core.env.base import AsyncEnv
from gem_core.types import ResetResult, StepResult

LONG_S = 60
"""Only ends a hang: what is waited for is an event."""

GATES: dict[str, threading.Event] = defaultdict(threading.Event)
"""What environments of this process wait for, by name."""

BEGUN: list[str] = []
"""The actions whose steps have begun, in this process."""


class ThreadCountdownEnv(CountdownEnv):
    """Counts down in a thread; a step waits for the gate that it is given."""

    concurrency = "thread"

    def __init__(self, gate: str = "", **options: Any) -> None:
        super().__init__(**options)
        self.gate = gate

    def step(self, action: str) -> StepResult:
        BEGUN.append(action)
        if self.gate and not GATES[self.gate].wait(LONG_S):
            raise TimeoutError(f"the gate {self.gate!r} was never opened")
        return super().step(action)


class AsyncCountdownEnv(AsyncEnv):
    """Counts down in a coroutine; a step waits for the gate that it is given."""

    def __init__(self, gate: str = "") -> None:
        super().__init__()
        self.inner = CountdownEnv()
        self.gate = gate

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        await super().reset_async(seed)
        return self.inner.reset(seed=seed, options=options)

    async def step_async(self, action: str) -> StepResult:
        while self.gate and not GATES[self.gate].is_set():
            await asyncio.sleep(0.001)
        return self.inner.step(action)

    def sample_random_action(self) -> str:
        return str(int(self.action_random.integers(1000)))


class PipeCountdownEnv(CountdownEnv):
    """Counts down in another process; a reset waits until somebody opens the pipe at the path that it is given."""

    concurrency = "process"

    def __init__(self, pipe: str = "") -> None:
        super().__init__()
        self.pipe = pipe

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        if self.pipe:
            Path(self.pipe).read_text()
        return super().reset(seed=seed, options=options)


KINDS = {
    "inline": "toy:Countdown-v0",
    "thread": "held:Thread-v0",
    "async": "held:Async-v0",
    "process": "held:Pipe-v0",
}


def register_held() -> None:
    """Register the environments above, with all gates closed and no step begun."""
    GATES.clear()
    BEGUN.clear()
    gem.register(KINDS["thread"], ThreadCountdownEnv)
    gem.register(KINDS["async"], AsyncCountdownEnv)
    gem.register(KINDS["process"], PipeCountdownEnv)
