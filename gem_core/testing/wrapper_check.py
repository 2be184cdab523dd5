"""``check_wrapper``: puts a wrapper around a small task and tries what the two promise together."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.env.base import Env
from gem_core.env.observations import observation_from
from gem_core.env.wrapper import AnyEnv, Wrapper, reset_async, step_async
from gem_core.testing.conformance import check_env
from gem_core.testing.contract import Report
from gem_core.testing.findings import Findings
from gem_core.types import ResetResult, StepResult

_ACTIONS = ("say 3", "hello", "say 7")


class SmallTask(Env):
    """Three turns; a number stands on the board, and naming it earns a reward. What wrappers are tried on."""

    answer = "what earlier wrappers must not hide"

    def __init__(self) -> None:
        super().__init__()
        self._number = self._turn = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Draw the first number."""
        super().reset(seed=seed)
        self._turn = 0
        return self._observed("Say the number.\n")

    def step(self, action: str) -> StepResult:
        """Compare, and draw the next."""
        right = action == f"say {self._number}"
        self._turn += 1
        observation, info = self._observed("Right.\n" if right else "Wrong.\n")
        over = self._turn == 3
        if over:
            info["correct"] = right
        return observation, float(right), over, False, info

    def sample_random_action(self) -> str:
        """Say some number."""
        return f"say {int(self.action_random.integers(10))}"

    def _observed(self, feedback: str) -> ResetResult:
        self._number = int(self.np_random.integers(10))
        suffix = f"The number is {self._number}. Turn {self._turn + 1} of 3."
        return observation_from(feedback, suffix), {"feedback": feedback, "suffix": suffix}

    def _get_state(self) -> dict[str, Any]:
        return {"number": self._number, "turn": self._turn}

    def _set_state(self, state: dict[str, Any]) -> None:
        self._number, self._turn = int(state["number"]), int(state["turn"])


def check_wrapper(make_wrapper: Callable[[AnyEnv], AnyEnv], *, skip: Mapping[str, str] | None = None) -> Report:
    """Try everything that a wrapper promises, around a small task of three turns.

    Args:
        make_wrapper: The class, or a function, that puts the wrapper around an environment.
        skip: Promises of ``check_env`` that are not to be tried, each by its slug, with the reason.

    Returns:
        What ``check_env`` says of the two together.

    Raises:
        CheckError: It hides the task, or its asynchronous methods say something else than its plain ones.
        ContractError: Around the task, the contract of environments is broken.
    """
    wrapped = make_wrapper(SmallTask())
    findings = Findings(f"wrapper {type(wrapped).__name__}")
    with contextlib.closing(wrapped):
        promise = "It derives from gem_core.Wrapper."
        if not findings.expect(promise, isinstance(wrapped, Wrapper), f"a {type(wrapped).__name__}"):
            findings.result()
        findings.expect("'unwrapped' is the task.", isinstance(wrapped.unwrapped, SmallTask), repr(wrapped.unwrapped))
        shown = getattr(wrapped, "answer", None)
        findings.expect("Attributes of the task are read through it.", shown == SmallTask.answer, repr(shown))
        plain, coroutines = _played(wrapped), asyncio.run(_played_async(wrapped))
        findings.expect(
            "Its coroutines give what its plain methods give.",
            plain == coroutines,
            f"{plain!r:.200} and {coroutines!r:.200}",
        )
        findings.result()
        return check_env(wrapped, skip=skip)


def _played(env: AnyEnv) -> list[Any]:
    results: list[Any] = [_lasting(env.reset(seed=1))]
    for action in _ACTIONS:
        results.append(_lasting(env.step(action)))
        if results[-1][2] or results[-1][3]:
            break
    return results


async def _played_async(env: AnyEnv) -> list[Any]:
    results: list[Any] = [_lasting(await reset_async(env, 1))]
    for action in _ACTIONS:
        results.append(_lasting(await step_async(env, action)))
        if results[-1][2] or results[-1][3]:
            break
    return results


def _lasting(result: tuple[Any, ...]) -> tuple[Any, ...]:
    *front, info = result
    if "episode" in info:  # its "t" is a duration
        info = {**info, "episode": {**info["episode"], "t": 0}}
    return (*front, info)
