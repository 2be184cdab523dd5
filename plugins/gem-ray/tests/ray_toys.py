"""Environments that actors import, which do what their actions say."""

from __future__ import annotations

import os
import re
import secrets
import threading
from pathlib import Path
from typing import Any

import gem_core as gem
from gem_core.types import ResetResult, StepResult


class TallyEnv(gem.Env):
    """Counts its turns from a number drawn at reset, for 12 turns; some actions are orders."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self.count, self.turn = int(self.np_random.integers(1000)), 0
        return f"begins at {self.count}", {}

    def step(self, action: str) -> StepResult:
        order, _, operand = action.partition(" ")
        self.turn += 1
        self.count += int(self.np_random.integers(10))
        observation = getattr(self, f"_{order}", str)(operand) if order.isidentifier() else ""
        return f"{observation or self.count}", float(self.turn), self.turn >= 12, False, {"turn": self.turn}

    def sample_random_action(self) -> str:
        return str(int(self.action_random.integers(1000)))

    def _exit(self, operand: str) -> str:
        os._exit(int(operand))

    def _hang(self, operand: str) -> str:
        # In C code that lets no other thread of Python run.
        return str(re.match("(a+)+b", "a" * 100))

    def _await(self, operand: str) -> str:
        # Reading from a pipe waits until somebody writes to it.
        return Path(operand).read_text()

    def _node(self, operand: str) -> str:
        import ray

        return str(ray.get_runtime_context().get_node_id())


class PairEnv(gem.MultiAgentEnv):
    """Two agents answer at once, for three steps; the longer answer earns a point."""

    possible_agents = ("left", "right")

    def __init__(self) -> None:
        super().__init__()
        self.agent_selector = gem.AgentSelector(mode="parallel")

    def begin_episode(self, options: dict[str, Any] | None) -> None:
        self.turn = 0

    def observe(self, agent: str) -> str:
        return f"{agent}, turn {self.turn}"

    def process_actions(self, actions: dict[str, str]) -> Any:
        self.turn += 1
        longest = max(actions, key=lambda agent: len(actions[agent]))
        return {longest: 1.0}, dict.fromkeys(actions, self.turn == 3), {}, {}

    def sample_random_action(self, agent: str) -> str:
        return "x" * int(self.action_random.integers(10))


class FarewellEnv(TallyEnv):
    """Notes in a folder that it was closed; or hangs there."""

    def __init__(self, folder: str, hangs: bool = False) -> None:
        super().__init__()
        self.folder, self.hangs = folder, hangs

    def close(self) -> None:
        if self.hangs:
            threading.Event().wait()
        Path(self.folder, secrets.token_hex(8)).touch()


def register_toys() -> None:
    """Register the environments above."""
    gem.register("raytoy:Tally-v0", "ray_toys:TallyEnv")
    gem.register("raytoy:Farewell-v0", "ray_toys:FarewellEnv")
    gem.register("raytoy:Pair-v0", "ray_toys:PairEnv", seats=("left", "right"))
