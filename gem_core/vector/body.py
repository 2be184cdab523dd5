"""``Body``: an environment in its place, which makes, resets and steps it, and keeps to itself what it raises."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, cast

from gem_core.background import in_thread
from gem_core.env.guard import Guard
from gem_core.env.results import checked_reset, checked_result
from gem_core.env.seeding import checked_seed
from gem_core.env.wrapper import AnyEnv, concurrency_of, reset_async, step_async
from gem_core.types import Concurrency, Observation, ResetResult, StepResult
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Rebuilt, Reset

logger = logging.getLogger("gem_core")

EnvFactory = Callable[[str | None, Mapping[str, Any]], AnyEnv]
"""Makes the environment for (id, keyword arguments)."""


class Body:
    """An environment of a slot, wherever it lives.

    Whatever it raises becomes a ``Failure``, and the environment is then closed: the next reset makes another.

    Args:
        index: Number of the slot.
        factory: Makes the environment.
    """

    __slots__ = ("_factory", "_step", "borrowed", "env", "index", "kind", "made_for", "sampled")

    def __init__(self, index: int, factory: EnvFactory) -> None:
        self.index = index
        self.env: AnyEnv | None = None
        self.kind: Concurrency | None = None
        """What the whole stack needs; None while there is no environment."""
        self.made_for: tuple[str | None, Mapping[str, Any]] | None = None
        self.borrowed: AnyEnv | None = None
        """An environment that belongs to the caller, who closes it."""
        self.sampled = False
        self._factory = factory
        self._step: Callable[[str], Any] = _nothing_to_step

    def prepare(self, env_id: str | None, kwargs: Mapping[str, Any]) -> Failure | None:
        """Make the environment for an id and keyword arguments, if it is not there; return what went wrong."""
        made_for = self.made_for
        if made_for is not None and made_for[0] == env_id and _equal(made_for[1], kwargs):
            return None
        self.discard()
        try:
            env = self._factory(env_id, kwargs)
            self.kind = concurrency_of(env)
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            _check_contained(error)
            return Failure.of(error, "reset", making=True)
        # The guard refuses a step outside an episode, which a slot never asks for, and results that are refused here.
        guard = env if type(env) is Guard and env is not self.borrowed else None
        if guard is not None:
            guard.checks_results = False
        self._step = (env if guard is None else guard.env).step
        self.env, self.made_for = env, (env_id, kwargs)
        return None

    def fits(self, command: Command) -> bool:
        """Tell whether a command is for the environment that is here."""
        made_for = self.made_for
        if type(command) is not Reset:
            return True
        if made_for is None or made_for[0] != command[0]:
            return False
        return made_for[1] is command[1] or _equal(made_for[1], command[1])

    def perform(self, command: Command) -> Outcome:
        """Do what a slot asks."""
        if isinstance(command, Reset):
            return self.reset(command)
        return self.step(command) if isinstance(command, str) else self.rebuild(command)

    async def perform_async(self, command: Command) -> Outcome:
        """Do what a slot asks without blocking the loop."""
        try:
            if isinstance(command, Reset):
                if failure := self.prepare(command.env_id, command.kwargs):
                    return failure
                self.sampled = False
                return checked_reset(await reset_async(cast("AnyEnv", self.env), command.seed, command.options))
            if isinstance(command, str):
                return checked_result(await step_async(self.env, command) if self.env else _nothing_to_step(command))
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "step" if isinstance(command, str) else "reset")
        return await in_thread(self.rebuild, command)

    def reset(self, command: Reset) -> ResetResult | Failure:
        """Begin an episode."""
        env_id, kwargs, seed, options = command
        if not self.fits(command) and (failure := self.prepare(env_id, kwargs)):
            return failure
        self.sampled = False
        env: Any = self.env
        try:
            return checked_reset(env.reset(seed=seed, options=options) if options else env.reset(seed=seed))
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "reset")

    def step(self, action: str) -> StepResult | Failure:
        """Step the environment."""
        try:
            result: Any = self._step(action)
            if type(result) is tuple and len(result) == 5:
                observation, reward, terminated, truncated, info = result
                if (
                    type(observation) is str
                    and type(reward) is float
                    and isfinite(reward)
                    and type(terminated) is type(truncated) is bool
                    and type(info) is dict
                ):
                    return observation, reward, terminated, truncated, info.copy()
            return checked_result(result)
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "step")

    def rebuild(self, command: Rebuild) -> Rebuilt | Failure:
        """Replay an episode and step it; a replay that goes another way than the first time is a failure."""
        observation = self.restore(command)
        if isinstance(observation, Failure):
            return observation
        outcome = self.step(command.action)
        return outcome if isinstance(outcome, Failure) else Rebuilt(observation, outcome)

    def restore(self, command: Rebuild) -> Observation | Failure:
        """Replay an episode up to the step that follows; return what was observed last."""
        outcome: Any = self.reset(command.reset)
        for action in command.actions:
            if isinstance(outcome, Failure) or (len(outcome) == 5 and (outcome[2] or outcome[3])):
                break
            outcome = self.step(action)
        if not isinstance(outcome, Failure) and not (len(outcome) == 5 and (outcome[2] or outcome[3])):
            return cast("Observation", outcome[0])
        self.discard()
        why = outcome.message if isinstance(outcome, Failure) else "its replay ended early"
        return Failure("collateral", f"its worker was lost, and the episode could not be replayed: {why}")

    def sample_random_action(self, seed: int | None) -> str:
        """Return a valid action for the present state, from a generator that starts at ``seed`` in each episode."""
        env = self.env
        if env is None:
            return ""
        if not self.sampled and seed is not None:
            if hasattr(task := env.unwrapped, "seed_actions"):
                task.seed_actions(checked_seed(seed))
            self.sampled = True
        return cast("str", env.get_wrapper_attr("sample_random_action")())

    def failed(self, error: BaseException, where: str) -> Failure:
        """Give the environment up."""
        _check_contained(error)
        logger.debug("gem: slot %d failed in %s", self.index, where, exc_info=error)
        self.discard()
        return Failure.of(error, where)

    def discard(self) -> None:
        """Close the environment, if there is one that is not the caller's."""
        env, self.env, self._step, self.made_for, self.kind = self.env, None, _nothing_to_step, None, None
        if env is None or env is self.borrowed:
            return
        try:
            env.close()
        except BaseException as error:
            _check_contained(error)
            logger.warning("gem: closing the environment of slot %d failed", self.index, exc_info=True)


def _equal(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    try:
        return first is second or first == second
    except ValueError:  # arrays refuse to be compared as a whole
        return False


def _nothing_to_step(action: str) -> Any:
    raise RuntimeError("there is no environment to step")


def _check_contained(error: BaseException) -> None:
    """Raise again what is not the environment's: Ctrl-C of the user, and the end of a coroutine that is collected.

    All else ends no more than an episode. Libraries raise what is no ``Exception`` too, as those in Rust that panic,
    and in a thread or a task it would be lost, so that its slot were waited for without end.
    """
    if isinstance(error, GeneratorExit):
        raise error
    if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
        raise error
