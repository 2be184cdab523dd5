"""The state of one slot, in every backend: what an episode starts from, autoreset, and faults.

A slot does not touch its environment. It returns the next command for the environment, takes the outcome, and in the
end holds a result. The scheduler runs it::

    command = slot.act("an action")
    while command is not None:
        command = slot.next_episode() if command is NEXT else slot.take_outcome(runner.perform(command))
    slot.result
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

from gem_core.docs import page_url
from gem_core.errors import ArgumentError, FaultBudgetError, ResetNeededError
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import TERMINAL_STATE, Action, Info, Observation, StepResult
from gem_core.vector.commands import Command, Failure, Reset
from gem_core.vector.joint import lost_step

Autoreset = Literal["same_step", "next_step", "disabled"]
"""When the next episode begins after one has ended; see ``make_vec``."""

OnError = Literal["truncate", "raise"]

NEW, LIVE, ENDED, IDLE, BROKEN = "new", "live", "ended", "idle", "broken"
"""Phases of a slot: before the first episode; in an episode; after one, before the next begins; without an episode,
since the plan is exhausted; without an environment, since an error was raised."""

NEXT: Any = object()
"""Returned instead of a command: call ``next_episode`` when it is this slot's turn."""


class FaultBudget:
    """Counts faults in a row, with no finished episode between them; shared by all slots.

    Args:
        limit: Number of faults in a row that is allowed.
        total: Number of faults so far.
    """

    def __init__(self, limit: int, total: int = 0) -> None:
        self.limit = limit
        self.total = total
        self._in_a_row = 0
        self._lock = threading.Lock()

    def finished(self) -> None:
        """Record an episode that ended without a fault."""
        self._in_a_row = 0

    def spend(self, error: dict[str, Any], what: str, cause: BaseException | None = None) -> None:
        """Count a fault.

        Raises:
            FaultBudgetError: The limit is exceeded; its cause is the exception of the last fault.
        """
        with self._lock:
            self.total += 1
            self._in_a_row += 1
            if self._in_a_row > self.limit:
                advice = "Mend the environment; each episode says where it failed in episode.error['frames']"
                if error.get("kind") == "agent":
                    advice = "It is the agent that fails, or the server that it asks, not the environment"
                where = f" ({error['frames'][-1]})" if error.get("frames") else ""
                raise FaultBudgetError(
                    f"{self._in_a_row} faults in a row without one finished episode; the last, in {what}: "
                    f"{error.get('message', error)}{where}. {advice}. See {page_url('vector-environments/#faults')}"
                ) from cause


@dataclass
class Rules:
    """Rules and counters that all slots of a vector environment share.

    Args:
        source: Queue from which slots draw their episodes.
        budget: Count of faults.
        autoreset: See ``make_vec``.
        on_error: ``"truncate"`` or ``"raise"``.
        step_timeout: Seconds that a command may take; None for no limit.
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
    """One slot of a vector environment, and its present episode.

    Args:
        index: Number of the slot.
        own_id: Id of the environment if the plan names none; None for an environment without an id.
        own_kwargs: Keyword arguments of that environment, which override those of the run.
        rules: Rules that all slots share.
    """

    __slots__ = (
        "_failed_resets",
        "_last_step",
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
        """The reset whose outcome is awaited."""
        self._options: dict[str, Any] | None = None
        self._failed_resets: list[dict[str, Any]] = []
        """The resets that failed since the last episode."""
        self._last_step: StepResult | None = None
        """The last step of the previous episode, while the reset after it is under way."""

    def begin(self, options: dict[str, Any] | None = None) -> Command:
        """Begin the next episode, also in the middle of one.

        A failed reset consumes its plan item, and the next item is tried; ``info["failed_resets"]`` lists the failures.
        When the plan is exhausted, the observation is ``TERMINAL_STATE`` and ``info["idle"]`` is true.
        """
        self._options, self._last_step, self._failed_resets = options, None, []
        return cast("Command", NEXT)

    @property
    def is_joint(self) -> bool:
        """Whether several agents act in the present episode."""
        return isinstance(self.result, tuple) and isinstance(self.result[0], dict)

    def act(self, action: Action) -> Command | None:
        """Step; ``autoreset`` decides what happens when the episode is over.

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

    def give_up(self, error: dict[str, Any] | None, cause: BaseException | None = None) -> Command:
        """Begin the next episode in the middle of one; an error counts as a fault, None does not."""
        if error is None:
            self.rules.budget.finished()
        else:
            self.rules.budget.spend(error, self.name(), cause)
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
                "call reset(options={'reset_mask': …}) before the next step(). "
                f"See {page_url('vector-environments/#when-episodes-end')}"
            )

    def next_episode(self) -> Command | None:
        """Return the reset of the plan's next episode; None if there is none, and the slot becomes idle."""
        start = self.episode = self.rules.source.draw(self.index)
        if start is None:
            self.phase = IDLE
            self._set_first_result(TERMINAL_STATE, {"idle": True})
            return None
        item, options = start.item, self._options
        if item.options or options:
            options = {**(options or {}), **(item.options or {})}
        kwargs = item.kwargs
        if self.own_kwargs and item.id is None:
            kwargs = {**self.own_kwargs, **kwargs}
        self._reset = Reset(item.id or self.own_id, kwargs, start.seed, options)
        return self._reset

    def take_outcome(self, outcome: Any) -> Command | None:
        """Take the ``Outcome`` of a command; return the next command, or None once there is a result.

        Raises:
            FaultBudgetError: The command failed, and the budget of faults is spent.
            EnvFaultError: The command failed, and ``on_error`` is ``"raise"``.
        """
        return self.take_step(outcome) if self._reset is None else self._take_reset(self._reset, outcome)

    def take_step(self, outcome: Any) -> Command | None:
        """Take the outcome of a step, a ``StepResult`` or a ``Failure``; see ``take_outcome``."""
        rules = self.rules
        if type(outcome) is Failure:
            outcome = lost_step(self._count_fault(outcome), joint=self.is_joint)
        elif not (outcome[2] or outcome[3]):
            self.result = outcome
            return None
        elif "error" in outcome[4]:
            self._note_error(outcome[4]["error"])
        else:
            rules.budget.finished()
        if rules.autoreset == "same_step":
            self.begin()
            # The environment may reuse its info dictionary in reset.
            self._last_step = outcome[0], outcome[1], outcome[2], outcome[3], outcome[4].copy()
            return cast("Command", NEXT)
        self.phase = ENDED
        self.result = outcome
        return None

    def name(self) -> str:
        """Return the name that errors use for this slot's environment."""
        return str((self.episode.item.id if self.episode is not None else None) or self.own_id or f"slot {self.index}")

    def _take_reset(self, reset: Reset, outcome: Any) -> Command | None:
        self._reset = None
        if type(outcome) is Failure:
            if outcome.permanent and outcome.error is not None:
                self.phase = BROKEN
                raise outcome.error
            self._failed_resets.append(self._describe_failed_reset(reset, self._count_fault(outcome)))
            return cast("Command", NEXT)
        observation, info = outcome
        info["seed"] = reset.seed
        group = self.episode.item.group if self.episode is not None else None
        if group is not None:
            info["group"] = group
        self.phase = LIVE
        self._set_first_result(observation, info)
        return None

    def _set_first_result(self, observation: Observation, info: Info) -> None:
        if self._failed_resets:
            info["failed_resets"], self._failed_resets = self._failed_resets, []
        ended = self._last_step
        if ended is None:
            self.result = (observation, {} if isinstance(observation, dict) else 0.0, False, False, info)
        else:
            self._last_step = None
            info["final_obs"], info["final_info"] = ended[0], ended[4]
            self.result = observation, ended[1], ended[2], ended[3], info

    def _describe_failed_reset(self, reset: Reset, error: dict[str, Any]) -> dict[str, Any]:
        start = cast("EpisodeStart", self.episode)
        return {
            "id": reset.env_id,
            "kwargs": dict(reset.kwargs),
            "options": None if start.item.options is None else dict(start.item.options),
            "seed": start.seed,
            "run_seed": start.run_seed,
            "group": start.item.group,
            "agent": start.item.agent,
            "key": start.key,
            "repeat": start.repeat,
            "error": error,
        }

    def _note_error(self, error: object) -> None:
        if error is None:
            self.rules.budget.finished()
        else:
            self.rules.budget.spend(error if isinstance(error, dict) else {"message": str(error)}, self.name())

    def _count_fault(self, failure: Failure) -> dict[str, Any]:
        """Count a failure as a fault and return its ``info["error"]``; raise it if ``on_error`` says so."""
        if self.rules.on_error == "raise":
            self.phase = BROKEN
            raise failure.raised(self.name())
        error = failure.info()
        if failure.kind != "collateral":
            self.rules.budget.spend(error, self.name(), failure.error or failure.raised(self.name()))
        return error
