"""What a slot asks of its environment, and what comes back: plain records that can travel to another process."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from gem_core.errors import (
    DatasetError,
    EntryPointError,
    GemError,
    MissingRequirementError,
    RegistrationError,
    UsageError,
)
from gem_core.types import ResetResult, StepResult

HOPELESS = (UsageError, RegistrationError, MissingRequirementError, EntryPointError, DatasetError)
"""Errors of making an environment that trying again, or another episode, does not mend."""

_LONGEST_MESSAGE = 2000


class Reset(NamedTuple):
    """Begin an episode, in the environment of an id and keyword arguments.

    Args:
        env_id: Id of the environment; None for the one that the slot has by itself.
        kwargs: Keyword arguments over those of the run.
        seed: Seed of the episode.
        options: What ``reset`` gets; None for nothing.
    """

    env_id: str | None
    kwargs: Mapping[str, Any]
    seed: int
    options: dict[str, Any] | None


class Rebuild(NamedTuple):
    """Bring an environment that was lost to where it was, by replaying its episode, and step it.

    Args:
        reset: How the episode began.
        actions: What was stepped since.
        action: What to step now.
    """

    reset: Reset
    actions: list[str]
    action: str


class Rebuilt(NamedTuple):
    """What came of a ``Rebuild``.

    Args:
        observation: The last one of the replay, to compare with the one of the first time.
        result: Of the step behind it.
    """

    observation: Any
    result: StepResult


@dataclass
class Failure:
    """An environment that could not do what it was asked.

    Args:
        kind: ``"exception"``, ``"timeout"``, ``"died"`` or ``"collateral"``.
        message: What happened, as ``info["error"]`` says it.
        error: The exception, where there is one and it can travel.
        details: Its traceback, where it comes from another process.
        hopeless: Whether trying again, or another episode, would fail the same way.
    """

    kind: str
    message: str
    error: BaseException | None = None
    details: str = ""
    hopeless: bool = False

    @classmethod
    def of(cls, error: BaseException, where: str, *, making: bool = False) -> Failure:
        """Return the failure that an exception is."""
        try:
            message = f"{where} raised {type(error).__name__}: {error}" if str(error) else f"{where} raised {error!r}"
        except Exception:  # noqa: BLE001 - an exception's own text may fail in any way
            message = f"{where} raised {type(error).__name__}, which cannot be shown"
        return cls("exception", message[:_LONGEST_MESSAGE], error, hopeless=making and isinstance(error, HOPELESS))

    def info(self) -> dict[str, Any]:
        """Return what ``info["error"]`` says."""
        return {"kind": self.kind, "message": self.message}

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors of our own are raised again on the other side; any other may need modules, or not survive the way.
        error = self.error if isinstance(self.error, GemError) and _travels(self.error) else None
        details = self.details
        if error is None and self.error is not None:
            import traceback

            details = "".join(traceback.format_exception(self.error))[-_LONGEST_MESSAGE:]
        return Failure, (self.kind, self.message, error, details, self.hopeless)


Command = str | Reset | Rebuild
"""What a slot asks: an action to step, or one of the others."""

Outcome = ResetResult | StepResult | Rebuilt | Failure
"""What comes back, by the kind of command."""


def _travels(error: BaseException) -> bool:
    try:
        return type(pickle.loads(pickle.dumps(error))) is type(error)
    except Exception:  # noqa: BLE001 - an exception's own pickling may fail in any way
        return False
