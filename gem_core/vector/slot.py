"""The rules of one slot, which every backend shares: what an episode starts from, autoreset, and faults."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

from gem_core.errors import (
    ArgumentError,
    DatasetError,
    EntryPointError,
    EnvFaultError,
    FaultBudgetError,
    MissingRequirementError,
    RegistrationError,
    ResetNeededError,
    UsageError,
)
from gem_core.plans import Draw, DrawSource
from gem_core.types import TERMINAL_STATE, Info, Observation, ResetResult, StepResult
from gem_core.wrapper import AnyEnv

logger = logging.getLogger("gem_core")

EnvFactory = Callable[[str | None, Mapping[str, Any]], AnyEnv]
"""Makes the environment for (id, keyword arguments)."""

_HOPELESS = (UsageError, RegistrationError, MissingRequirementError, EntryPointError, DatasetError)
"""Errors of making an environment that trying again, or another episode, does not mend."""


class _Hopeless(Exception):
    """Carries such an error out of the slot's own guard."""


class SlotStep(NamedTuple):
    """What a slot gives for one action; see ``VectorEnv.step``."""

    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: Info


class FaultBudget:
    """Counts faults in a row, with no finished episode between them; shared by all slots.

    Args:
        limit: Number of faults in a row that is still borne.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.total = 0
        self._in_a_row = 0
        self._lock = threading.Lock()

    def finished(self) -> None:
        """Note an episode that ended by itself."""
        self._in_a_row = 0

    def spend(self, error: dict[str, Any], what: str) -> None:
        """Note a fault.

        Raises:
            FaultBudgetError: It was one too many.
        """
        with self._lock:
            self.total += 1
            self._in_a_row += 1
            if self._in_a_row > self.limit:
                advice = "Mend the environment, or use on_error='raise' to see where it fails"
                if error.get("kind") == "agent":
                    advice = "It is the agent that fails, or the server that it asks, not the environment"
                raise FaultBudgetError(
                    f"{self._in_a_row} faults in a row without one finished episode; the last, in {what}: "
                    f"{error.get('message', error)}. {advice}"
                )


class Slot:
    """One place of a vector environment: an environment, and the episode it is in.

    Args:
        index: Number of the slot.
        own_id: Id of the environment where the plan names none; None for one that has no id.
        factory: Makes the environment.
        source: What episodes start from.
        budget: Shared count of faults.
        on_error: ``"truncate"`` or ``"raise"``.
    """

    def __init__(
        self,
        index: int,
        own_id: str | None,
        factory: EnvFactory,
        source: DrawSource,
        budget: FaultBudget,
        on_error: str = "truncate",
    ) -> None:
        if on_error not in ("truncate", "raise"):
            raise ArgumentError(f"on_error must be 'truncate' or 'raise', not {on_error!r}")
        self.index = index
        self.own_id = own_id
        self.source = source
        self.draw: Draw | None = None
        self.borrowed: AnyEnv | None = None
        """An environment that belongs to the caller, who closes it."""
        self._factory = factory
        self._budget = budget
        self._on_error = on_error
        self._env: AnyEnv | None = None
        self._made_for: tuple[str | None, dict[str, Any]] | None = None

    @property
    def idle(self) -> bool:
        """Whether the plan had nothing left for this slot."""
        return self.draw is None

    @property
    def env(self) -> AnyEnv | None:
        """The environment of the present episode; None before the first, and after a fault."""
        return self._env

    def begin(self, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin the next episode.

        A reset that fails uses its plan item up, and the next is tried: ``info["failed_resets"]`` then lists what
        failed, each with ``draw`` and ``error``. When the plan is exhausted, the observation is ``TERMINAL_STATE`` and
        ``info["idle"]`` is true.
        """
        failed: list[dict[str, Any]] = []
        result: ResetResult | None = None
        while result is None:
            self.draw = self.source.draw(self.index)
            if self.draw is None:
                self._discard()
                result = (TERMINAL_STATE, {"idle": True})
                continue
            try:
                result = self._reset(self.draw, options)
            except _Hopeless as hopeless:
                raise cast("BaseException", hopeless.__cause__) from None
            except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever an environment does stays in its slot
                failed.append({"draw": self.draw, "error": self._fault(error, "reset")})
        if failed:
            result[1]["failed_resets"] = failed
        return result

    def step(self, action: str) -> SlotStep:
        """Step, and begin the next episode in the same call when this one ends.

        Raises:
            ResetNeededError: The slot was left without an environment, by an error that was raised.
        """
        if self.draw is None:
            return SlotStep(TERMINAL_STATE, 0.0, False, False, {"idle": True})
        if self._env is None:
            raise ResetNeededError(f"slot {self.index} has no environment since an error was raised; call reset()")
        try:
            observation, reward, terminated, truncated, info = checked_result(self._env.step(action))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever an environment does stays in its slot
            fault = self._fault(error, "step")
            observation, reward, terminated, truncated, info = TERMINAL_STATE, 0.0, False, True, {"error": fault}
        else:
            if terminated or truncated:
                self._note_end(info)
        if not (terminated or truncated):
            return SlotStep(observation, reward, terminated, truncated, info)
        first_observation, first_info = self.begin()
        first_info["final_obs"], first_info["final_info"] = observation, info
        return SlotStep(first_observation, reward, terminated, truncated, first_info)

    def give_up(self, fault: str | None) -> ResetResult:
        """Begin the next episode in the middle of one; what failed spends the budget of faults, None does not."""
        if fault is None:
            self._budget.finished()
        else:
            self._budget.spend({"kind": "agent", "message": fault}, self._name())
        return self.begin()

    def sample_random_action(self) -> str:
        """Return a valid action for the present state."""
        if self._env is None:
            return ""
        return cast("str", self._env.get_wrapper_attr("sample_random_action")())

    def close(self) -> None:
        """Close the environment."""
        self._discard()

    def prepare(self, env_id: str | None) -> AnyEnv:
        """Return the environment that an episode of ``env_id`` will use, made now if it is not there."""
        wanted: tuple[str | None, dict[str, Any]] = (env_id or self.own_id, {})
        if self._env is None or self._made_for != wanted:
            try:
                self._change_env(wanted)
            except _Hopeless as hopeless:
                raise cast("BaseException", hopeless.__cause__) from None
        return cast("AnyEnv", self._env)

    def _change_env(self, wanted: tuple[str | None, dict[str, Any]]) -> None:
        self._discard()
        try:
            self._env = self._factory(*wanted)
        except _HOPELESS as error:
            raise _Hopeless from error
        self._made_for = wanted

    def _note_end(self, info: Info) -> None:
        error = info.get("error")
        if error is None:
            self._budget.finished()
        else:
            self._budget.spend(error if isinstance(error, dict) else {"message": str(error)}, self._name())

    def _name(self) -> str:
        return str((self.draw.item.id if self.draw is not None else None) or self.own_id or f"slot {self.index}")

    def _reset(self, draw: Draw, options: dict[str, Any] | None) -> ResetResult:
        wanted = (draw.item.id or self.own_id, dict(draw.item.kwargs))
        if self._env is None or self._made_for != wanted:
            self._change_env(wanted)
        env = cast("AnyEnv", self._env)
        chosen = {**(options or {}), **(draw.item.options or {})}
        if chosen:
            observation, info = checked_reset(env.reset(seed=draw.seed, options=chosen))
        else:
            observation, info = checked_reset(env.reset(seed=draw.seed))
        if hasattr(task := env.unwrapped, "seed_actions"):
            task.seed_actions(draw.action_seed)
        info["seed"] = draw.seed
        if draw.item.group is not None:
            info["group"] = draw.item.group
        return observation, info

    def _fault(self, error: BaseException, where: str) -> dict[str, Any]:
        """Give up the environment and return what ``info["error"]`` says; its replacement is made when needed."""
        self._discard()
        if self._on_error == "raise":
            raise EnvFaultError(f"{self._name()}: {where} raised {type(error).__name__}: {error}") from error
        logger.debug("gem: %s failed in %s", self._name(), where, exc_info=error)
        message = f"{where} raised {type(error).__name__}: {error}" if str(error) else f"{where} raised {error!r}"
        fault = {"kind": "exception", "message": message[:2000]}
        self._budget.spend(fault, self._name())
        return fault

    def _discard(self) -> None:
        env, self._env, self._made_for = self._env, None, None
        if env is None or env is self.borrowed:
            return
        try:
            env.close()
        except (Exception, SystemExit):
            logger.warning("gem: closing the environment of slot %d failed", self.index, exc_info=True)


def checked_result(result: object) -> StepResult:
    """Return a step's result if it is one.

    Raises:
        TypeError: It is not five values, or a value has a wrong type.
        ValueError: The reward is not finite.

    The info is copied: what the environment does with its own dictionary later changes nothing that was recorded.
    """
    if not isinstance(result, tuple) or len(result) != 5:
        raise TypeError(f"step must return (observation, reward, terminated, truncated, info), not {result!r:.200}")
    observation, reward, terminated, truncated, info = result
    reward = float(reward)
    if not math.isfinite(reward):
        raise ValueError(f"the reward must be a finite number, not {reward}")
    _check_types(observation, info)
    return observation, reward, bool(terminated), bool(truncated), info.copy()


def checked_reset(result: object) -> ResetResult:
    """Return a reset's result if it is one, its info copied as by ``checked_result``.

    Raises:
        TypeError: It is not two values, or a value has a wrong type.
    """
    if not isinstance(result, tuple) or len(result) != 2:
        raise TypeError(f"reset must return (observation, info), not {result!r:.200}")
    observation, info = result
    _check_types(observation, info)
    return observation, info.copy()


def _check_types(observation: object, info: object) -> None:
    if not isinstance(observation, str | list):
        raise TypeError(f"an observation must be text or a list, not {type(observation).__name__}")
    if not isinstance(info, dict):
        raise TypeError(f"info must be a dictionary, not {type(info).__name__}")
