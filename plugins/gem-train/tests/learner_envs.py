"""A toy environment to learn in, and a learner small enough for it."""

from __future__ import annotations

import functools
from typing import Any

import torch

import gem_core as gem
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.training import warm_start

torch.set_num_threads(1)  # more only get into each other's way with so little to compute


class TwoArms(gem.Env):
    """Asks for left or right in each turn and pays for right; what it writes is of different lengths."""

    def __init__(self, turns: int = 1, fails: bool = False) -> None:
        super().__init__()
        self.turns, self.fails, self.turn = turns, fails, 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.turn = 0
        return self._text("Say left or right."), {}

    def step(self, action: str) -> Any:
        self.turn += 1
        if self.fails and self.np_random.integers(2):
            raise ConnectionError("no server")
        over = self.turn == self.turns
        right = "right" in action
        feedback, suffix = f"Pulled {self.turn}.", self._text(" Again.")
        info: dict[str, Any] = {"feedback": feedback, "suffix": suffix}
        return feedback + suffix, float(right), over, False, info | ({"correct": right} if over else {})

    def sample_random_action(self) -> str:
        return str(self.np_random.choice(["left", "right"]))

    def _text(self, begins: str) -> str:
        return begins + "\n" + "pull" * int(self.np_random.integers(5))


class SometimesAbsent(TwoArms):
    """Does not begin from one seed in three, writes down that there was no error, and has no random actions."""

    sample_random_action = gem.Env.sample_random_action

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        if seed is not None and seed % 3 == 0:
            raise ConnectionError("no server")
        return super().reset(seed, options)

    def step(self, action: str) -> Any:
        *result, info = super().step(action)
        return *result, info | {"error": None}


def always_right(observation: Any) -> str:
    """Imitated, to learn from."""
    return "right"


def interrupts(observation: Any) -> str:
    """As a person who presses Ctrl-C does."""
    raise KeyboardInterrupt


def register() -> None:
    """Register the toy environment, once."""
    for env_id, kwargs in (("arms:One-v0", {}), ("arms:Four-v0", {"turns": 4}), ("arms:Failing-v0", {"fails": True})):
        if env_id not in gem.list_envs("arms"):
            gem.register(env_id, TwoArms, **kwargs)
    if "arms:Absent-v0" not in gem.list_envs("arms"):
        gem.register("arms:Absent-v0", SometimesAbsent)


def tiny(env: str | tuple[str, ...] = "arms:One-v0", **given: Any) -> TrainOptions:
    """Return options for a policy that learns in a moment."""
    register()
    small = {
        "updates": 4,
        "episodes": 16,
        "width": 16,
        "layers": 1,
        "heads": 2,
        "context": 96,
        "max_tokens": 3,
        "imitate": "random",
        "imitate_episodes": 32,
        "imitate_steps": 20,
        "eval_episodes": 8,
        "threads": 1,
    }
    return TrainOptions(env=(env,) if isinstance(env, str) else env, **{**small, **given})


@functools.cache
def _both_arms() -> dict[str, Any]:
    return tiny_learner(imitate_steps=60).state()


def learner_of_both_arms(**given: Any) -> Learner:
    """Return one that says left or right, and seldom anything else."""
    return Learner.restored(_both_arms() | {"options": tiny(imitate_steps=60, **given).to_dict()})


def tiny_learner(env: str = "arms:One-v0", **given: Any) -> Learner:
    """Return a learner that has imitated."""
    return warm_start(tiny(env, **given))
