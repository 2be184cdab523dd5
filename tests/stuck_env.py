"""An environment that hangs, for tests of workers: they must be able to import it."""

from __future__ import annotations

import threading

from toys import CountdownEnv

from gem_core.types import StepResult


class StuckEnv(CountdownEnv):
    """Never comes back from a step."""

    def step(self, action: str) -> StepResult:
        threading.Event().wait()
        return super().step(action)
