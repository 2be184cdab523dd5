"""The rules of one slot, which every backend shares: what an episode starts from, autoreset, and faults.

A slot touches no environment. It returns the next command for its environment, takes the outcome, and in the end holds
a result. The scheduler drives it::

    command = slot.act("an action")
    while command is not None:
        command = slot.next_episode() if command is NEXT else slot.took(runner.perform(command))
    slot.result
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

from gem_core.errors import ArgumentError, EnvFaultError, FaultBudgetError, ResetNeededError
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import TERMINAL_STATE, Info, Observation, StepResult
from gem_core.vector.commands import Command, Failure, Reset

Autoreset = Literal["same_step", "next_step", "disabled"]
"""When the episode that follows a finished one begins; see ``make_vec``."""

OnError = Literal["truncate", "raise"]

NEW, LIVE, ENDED, IDLE, BROKEN = "new", "live", "ended", "idle", "broken"
"""Phases of a slot: before the first episode; in one; behind one that nothing followed yet; without any, since the plan
is exhausted; left without an environment by an error that was raised."""

NEXT: Any = object()
"""Instead of a command: call ``next_episode``, as soon as it is this slot's turn."""


class FaultBudget:
    """Counts faults in a row, with no finished episode between them; shared by all slots.

    Args:
        limit: Number of faults in a row that is still borne.
        total: Number of faults so far.
    """

    def __init__(self, limit: int, total: int = 0) -> None:
        self.limit = limit
        self.total = total
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


@dataclass
class Rules:
    """What all slots of a vector environment share.

    Args:
        source: What episodes start from.
        budget: Count of faults.
        autoreset: See ``make_vec``.
        on_error: ``"truncate"`` or ``"raise"``.
        step_timeout: Seconds that a command may take; None for as long as it likes.
    """

    source: EpisodeQueue
    budget: FaultBudget
    autoreset: Autoreset = "same_step"
    on_error: OnError = "truncate"
    step_timeout: float | None = None

    def __post_init__(self) -> None:
        if self.on_error not in get_args(OnError):
            raise ArgumentError(f"on_error must be 'truncate' or 'raise', not {self.on_error!r}")
        if self.autoreset not in get_args(Autoreset):
            raise ArgumentError(f"autoreset must be 'same_step', 'next_step' or 'disabled', not {self.autoreset!r}")


class Slot:
    """One place of a vector environment, and the episode it is in.

    Args:
        index: Number of the slot.
        own_id: Id of the environment where the plan names none; None for one that has no id.
        own_kwargs: Keyword arguments of that environment, over those of the run.
        rules: Shared by all slots.
    """

    __slots__ = (
        "_ended",
        "_failed",
        "_options",
        "_reset",
        "episode",
        "index",
        "own_id",
        "own_kwargs",
        "phase",
        "result",
        "rules",
    )

    def __init__(self, index: int, own_id: str | None, own_kwargs: Mapping[str, Any], rules: Rules) -> None:
        self.index = index
        self.own_id = own_id
        self.own_kwargs = own_kwargs
        self.rules = rules
        self.phase = NEW
        self.episode: EpisodeStart | None = None
        """What the present episode started from."""
        self.result: Any = None
        """The five values of a step, or an exception, once there is no next command."""
        self._reset: Reset | None = None
        """The reset that is under way."""
        self._options: dict[str, Any] | None = None
        self._failed: list[dict[str, Any]] = []
        """The resets that failed since the last episode."""
        self._ended: StepResult | None = None
        """The last step of the episode that was followed by the present reset."""

    # What is asked of it.

    def begin(self, options: dict[str, Any] | None = None) -> Command:
        """Begin the next episode, also in the middle of one.

        A reset that fails uses its plan item up, and the next is tried: ``info["failed_resets"]`` then lists what
        failed. When the plan is exhausted, the observation is ``TERMINAL_STATE`` and ``info["idle"]`` is true.
        """
        self._options, self._ended, self._failed = options, None, []
        return cast("Command", NEXT)

    def act(self, action: str) -> Command | None:
        """Step; what follows the end of an episode is decided by autoreset.

        Raises:
            ResetNeededError: There is no episode, and none begins by itself.
        """
        if self.phase is LIVE:
            return action
        if self.phase is IDLE:
            self.result = (TERMINAL_STATE, 0.0, False, False, {"idle": True})
            return None
        self.check_steppable()
        return self.begin()  # next_step: this call begins the next episode, and its action is ignored

    def give_up(self, error: dict[str, Any] | None) -> Command:
        """Begin the next episode in the middle of one; an error spends the budget of faults, None does not."""
        if error is None:
            self.rules.budget.finished()
        else:
            self.rules.budget.spend(error, self.name())
        return self.begin()

    def check_steppable(self) -> None:
        """Raise what ``act`` would.

        Raises:
            ResetNeededError: There is no episode, and none begins by itself.
        """
        if self.phase is BROKEN:
            raise ResetNeededError(f"slot {self.index} has no environment since an error was raised; call reset()")
        if self.phase is NEW:
            raise ResetNeededError("the vector environment has not begun; call reset() before the first step()")
        if self.phase is ENDED and self.rules.autoreset == "disabled":
            raise ResetNeededError(
                f"the episode of slot {self.index} is over, and autoreset is disabled; "
                "call reset(options={'reset_mask': …}) before the next step()"
            )

    def next_episode(self) -> Command | None:
        """Return the reset of the next episode of the plan; None where there is none, and the slot is idle."""
        start = self.episode = self.rules.source.draw(self.index)
        if start is None:
            self.phase = IDLE
            self._began(TERMINAL_STATE, {"idle": True})
            return None
        item, options = start.item, self._options
        if item.options or options:
            options = {**(options or {}), **(item.options or {})}
        kwargs = item.kwargs
        if self.own_kwargs and item.id is None:
            kwargs = {**self.own_kwargs, **kwargs}
        self._reset = Reset(item.id or self.own_id, kwargs, start.seed, options)
        return self._reset

    def took(self, outcome: Any) -> Command | None:
        """Take the ``Outcome`` of a command; return the next command, or None once there is a result.

        Raises:
            FaultBudgetError: It failed once too often.
            EnvFaultError: It failed, and ``on_error`` is ``"raise"``.
        """
        return self.took_step(outcome) if self._reset is None else self._took_reset(self._reset, outcome)

    def took_step(self, outcome: Any) -> Command | None:
        """Take the outcome of a step, a ``StepResult`` or a ``Failure``; see ``took``."""
        rules = self.rules
        if type(outcome) is Failure:
            outcome = TERMINAL_STATE, 0.0, False, True, {"error": self._fault(outcome)}
        elif not (outcome[2] or outcome[3]):
            self.result = outcome
            return None
        elif "error" in outcome[4]:
            self._note_error(outcome[4]["error"])
        else:
            rules.budget.finished()
        if rules.autoreset == "same_step":
            self.begin()
            # The environment may use its dictionary again in reset.
            self._ended = outcome[0], outcome[1], outcome[2], outcome[3], outcome[4].copy()
            return cast("Command", NEXT)
        self.phase = ENDED
        self.result = outcome
        return None

    def name(self) -> str:
        """Return what an error calls it."""
        return str((self.episode.item.id if self.episode is not None else None) or self.own_id or f"slot {self.index}")

    def _took_reset(self, reset: Reset, outcome: Any) -> Command | None:
        self._reset = None
        if type(outcome) is Failure:
            if outcome.permanent and outcome.error is not None:
                self.phase = BROKEN
                raise outcome.error
            self._failed.append(self._as_failed(reset, self._fault(outcome)))
            return cast("Command", NEXT)
        observation, info = outcome
        info["seed"] = reset.seed
        group = self.episode.item.group if self.episode is not None else None
        if group is not None:
            info["group"] = group
        self.phase = LIVE
        self._began(observation, info)
        return None

    def _began(self, observation: Observation, info: Info) -> None:
        if self._failed:
            info["failed_resets"], self._failed = self._failed, []
        ended = self._ended
        if ended is None:
            self.result = (observation, 0.0, False, False, info)
        else:
            self._ended = None
            info["final_obs"], info["final_info"] = ended[0], ended[4]
            self.result = observation, ended[1], ended[2], ended[3], info

    def _as_failed(self, reset: Reset, error: dict[str, Any]) -> dict[str, Any]:
        start = cast("EpisodeStart", self.episode)
        return {
            "id": reset.env_id,
            "kwargs": dict(reset.kwargs),
            "options": None if start.item.options is None else dict(start.item.options),
            "seed": start.seed,
            "run_seed": start.run_seed,
            "group": start.item.group,
            "key": start.key,
            "repeat": start.repeat,
            "error": error,
        }

    def _note_error(self, error: object) -> None:
        if error is None:
            self.rules.budget.finished()
        else:
            self.rules.budget.spend(error if isinstance(error, dict) else {"message": str(error)}, self.name())

    def _fault(self, failure: Failure) -> dict[str, Any]:
        """Return what ``info["error"]`` says of a failure, and count it."""
        if self.rules.on_error == "raise":
            self.phase = BROKEN
            raised = EnvFaultError(f"{self.name()}: {failure.message}")
            if failure.details:
                raised.add_note(failure.details)
            raise raised from failure.error
        error = failure.info()
        if failure.kind != "collateral":
            self.rules.budget.spend(error, self.name())
        return error
