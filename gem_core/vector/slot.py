"""The rules of one slot, which every backend shares: what an episode starts from, autoreset, and faults.

A slot touches no environment. It says what to ask of it next, is told what came of that, and in the end holds a result.
Whoever runs the environments, here or in another process, drives it::

    command = slot.act("an action")
    while command is not None:
        command = slot.took(body.perform(command))
    slot.result
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast, get_args

from gem_core.errors import ArgumentError, EnvFaultError, FaultBudgetError, ResetNeededError
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import TERMINAL_STATE, Info, Observation, StepResult
from gem_core.vector.commands import Command, Failure, Rebuild, Rebuilt, Reset

Autoreset = Literal["same_step", "next_step", "disabled"]
"""When the episode that follows a finished one begins; see ``make_vec``."""

OnError = Literal["truncate", "raise"]

NEW, LIVE, ENDED, IDLE, BROKEN = "new", "live", "ended", "idle", "broken"
"""Phases of a slot: before the first episode; in one; behind one that nothing followed yet; without any, since the plan
is exhausted; left without an environment by an error that was raised."""

WAIT: Any = object()
"""Instead of a command: the slot waits for its turn to draw from the plan; see ``Slot.in_turn``."""


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
        replayable: Whether an episode of an id can be replayed from its seed and actions, where environments may be
            lost; None where they cannot be.
    """

    source: EpisodeQueue
    budget: FaultBudget
    autoreset: Autoreset = "same_step"
    on_error: OnError = "truncate"
    replayable: Callable[[str | None], bool] | None = None

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
        "_actions",
        "_asked",
        "_ended",
        "_failed",
        "_lost",
        "_observation",
        "_options",
        "_reset",
        "draw",
        "in_turn",
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
        self.draw: EpisodeStart | None = None
        """What the present episode started from."""
        self.result: Any = None
        """A ``SlotStep``, or five values like it, once there is nothing more to ask; or an exception."""
        self.in_turn = False
        """Whether it waits for its turn to draw from a plan, so that the order of completion decides nothing."""
        self._asked: Command | None = None
        self._options: dict[str, Any] | None = None
        self._failed: list[dict[str, Any]] | None = None
        self._ended: StepResult | None = None
        self._reset: Reset | None = None
        # Where its environment may be lost: what was stepped in this episode, and what was observed last.
        self._actions: list[str] | None = None
        self._observation: Observation = ""
        self._lost = False

    # What is asked of it.

    def begin(self, options: dict[str, Any] | None = None) -> Command | None:
        """Begin the next episode, also in the middle of one.

        A reset that fails uses its plan item up, and the next is tried: ``info["failed_resets"]`` then lists what
        failed. When the plan is exhausted, the observation is ``TERMINAL_STATE`` and ``info["idle"]`` is true.
        """
        self._options, self._ended, self._failed = options, None, None
        return self._next()

    def act(self, action: str) -> Command | None:
        """Step; what follows the end of an episode is the matter of autoreset.

        Raises:
            ResetNeededError: There is no episode, and none begins by itself.
        """
        if self.phase is LIVE:
            if self._lost:
                return self._act_lost(action)
            self._asked = action
            return action
        if self.phase is IDLE:
            self.result = SlotStep(TERMINAL_STATE, 0.0, False, False, {"idle": True})
            return None
        self.check_steppable()
        return self.begin()  # next_step: this call begins the next episode, and its action is ignored

    def give_up(self, error: dict[str, Any] | None) -> Command | None:
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

    # What it is told.

    def took(self, outcome: Any) -> Command | None:
        """Take what came of a command, an ``Outcome``; return the next command, or None once there is a result.

        Raises:
            FaultBudgetError: It failed once too often.
            EnvFaultError: It failed, and ``on_error`` is ``"raise"``.
        """
        asked = self._asked
        if type(asked) is Reset:
            return self._took_reset(asked, outcome)
        if type(asked) is Rebuild:
            if type(outcome) is Rebuilt and outcome.observation != self._observation:
                message = "its worker was lost, and a replay of the episode went another way: it is not deterministic"
                outcome = Failure("collateral", message)
            elif type(outcome) is Rebuilt:
                outcome = outcome.result
        return self.took_step(outcome)

    def took_step(self, outcome: Any) -> Command | None:
        """Take what came of a step, a ``StepResult`` or a ``Failure``; see ``took``."""
        rules = self.rules
        if type(outcome) is Failure:
            outcome = TERMINAL_STATE, 0.0, False, True, {"error": self._fault(outcome)}
        elif not (outcome[2] or outcome[3]):
            self.result = outcome
            if self._actions is not None:
                self._actions.append(self._stepped_action())
                self._observation = outcome[0]
            return None
        elif "error" in outcome[4]:
            self._note_error(outcome[4]["error"])
        else:
            rules.budget.finished()
        if rules.autoreset == "same_step":
            self._ended = outcome
            self._options = self._failed = None
            return self._next()
        self.phase = ENDED
        self.result = outcome
        return None

    def drawn(self) -> Command | None:
        """Draw what the next episode starts from, now that it is this slot's turn."""
        draw = self.draw = self.rules.source.draw(self.index)
        self._lost = False
        if draw is None:
            self.phase = IDLE
            self._reset = self._actions = None
            self._began(TERMINAL_STATE, {"idle": True})
            return None
        item, options = draw.item, self._options
        if item.options or options:
            options = {**(options or {}), **(item.options or {})}
        kwargs = item.kwargs
        if self.own_kwargs and item.id is None:
            kwargs = {**self.own_kwargs, **kwargs}
        self._asked = self._reset = Reset(item.id or self.own_id, kwargs, draw.seed, options)
        return self._asked

    def launch(self, command: Command) -> bool:
        """Note that a command goes to where the environment lives; tell whether that has not been lost meanwhile.

        Whoever calls this holds the lock under which ``lost`` is called: a worker may die at any moment.
        """
        if isinstance(command, str):
            return not self._lost
        self._lost = False  # what this brings about is a new environment
        return True

    def lost(self, failure: Failure | None, *, under_way: bool) -> Command | None:
        """Note that its environment is gone with the process that it lived in.

        Args:
            failure: What happened, where it was this environment that did it; None for one that stood beside it.
            under_way: Whether a command was.

        Returns:
            What to ask of a new environment; None where nothing was under way, or where there is a result.
        """
        asked, self._lost = self._asked, True
        if not under_way or asked is None:
            return None
        if failure is not None:
            return self.took(failure)
        if type(asked) is Reset:
            return asked
        return self._act_lost(asked.action if isinstance(asked, Rebuild) else cast("str", asked))

    def rebuilding(self) -> Rebuild | None:
        """Return how to bring its environment to where it was, if that was lost and can be; else None."""
        if not self._lost or self._actions is None or self._reset is None:
            return None
        return Rebuild(self._reset, self._actions, "")

    def name(self) -> str:
        """Return what an error calls it."""
        return str((self.draw.item.id if self.draw is not None else None) or self.own_id or f"slot {self.index}")

    # Its own matters.

    def _next(self) -> Command | None:
        if self.in_turn:
            return cast("Command", WAIT)
        return self.drawn()

    def _took_reset(self, asked: Reset, outcome: Any) -> Command | None:
        if type(outcome) is Failure:
            if outcome.hopeless and outcome.error is not None:
                self.phase = BROKEN
                raise outcome.error
            self._note_failed(asked, self._fault(outcome))
            return self._next()
        observation, info = outcome
        info["seed"] = asked.seed
        group = self.draw.item.group if self.draw is not None else None
        if group is not None:
            info["group"] = group
        self.phase = LIVE
        if self.rules.replayable is not None:
            self._actions = [] if self.rules.replayable(asked.env_id) else None
            self._observation = observation
        self._began(observation, info)
        return None

    def _began(self, observation: Observation, info: Info) -> None:
        self._asked = None
        if self._failed:
            info["failed_resets"], self._failed = self._failed, None
        ended = self._ended
        if ended is None:
            self.result = SlotStep(observation, 0.0, False, False, info)
        else:
            self._ended = None
            info["final_obs"], info["final_info"] = ended[0], ended[4]
            self.result = observation, ended[1], ended[2], ended[3], info

    def _act_lost(self, action: str) -> Command | None:
        if self._actions is None:
            message = "its worker was lost with another environment, and this episode cannot be replayed"
            return self.took_step(Failure("collateral", message))
        self._asked = Rebuild(cast("Reset", self._reset), self._actions, action)
        return self._asked

    def _stepped_action(self) -> str:
        asked = self._asked
        return asked.action if isinstance(asked, Rebuild) else cast("str", asked)

    def _note_failed(self, asked: Reset, error: dict[str, Any]) -> None:
        draw = cast("EpisodeStart", self.draw)
        failed: dict[str, Any] = {
            "id": asked.env_id,
            "kwargs": dict(asked.kwargs),
            "options": None if draw.item.options is None else dict(draw.item.options),
            "seed": draw.seed,
            "run_seed": draw.run_seed,
            "group": draw.item.group,
            "key": draw.key,
            "repeat": draw.repeat,
            "error": error,
        }
        self._failed = [*(self._failed or ()), failed]

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
