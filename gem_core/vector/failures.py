"""``Failure``: an exception, a hang or a death as plain data that can be sent to another process."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from typing import Any

from gem_core.errors import (
    DatasetError,
    EntryPointError,
    EnvFaultError,
    GemError,
    MissingRequirementError,
    RegistrationError,
    UsageError,
)
from gem_core.failures import author_frames, failure_info

_PERMANENT = (UsageError, RegistrationError, MissingRequirementError, EntryPointError, DatasetError)
"""Errors of making an environment that would occur again in every episode."""

_LONGEST_MESSAGE = 2000


@dataclass
class Failure:
    """Why a reset or a step of an environment has no result.

    Args:
        kind: ``"exception"``, ``"timeout"``, ``"died"`` or ``"collateral"``.
        message: The text of ``info["error"]["message"]``.
        error: The exception, if there is one and it can be pickled.
        details: Its traceback, if it comes from another process.
        permanent: Whether another attempt, or another episode, would fail the same way.
        frames: Lines of the author's code that the exception passed through; see ``author_frames``.
    """

    kind: str
    message: str
    error: BaseException | None = None
    details: str = ""
    permanent: bool = False
    frames: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, error: BaseException, where: str, *, making: bool = False) -> Failure:
        """Return an exception as a failure."""
        try:
            message = f"{where} raised {type(error).__name__}: {error}" if str(error) else f"{where} raised {error!r}"
        except Exception:  # noqa: BLE001 - an exception's own text may raise anything
            message = f"{where} raised {type(error).__name__}, which cannot be shown"
        permanent = making and isinstance(error, _PERMANENT)
        return cls("exception", message[:_LONGEST_MESSAGE], error, permanent=permanent, frames=author_frames(error))

    def info(self) -> dict[str, Any]:
        """Return what ``info["error"]`` says."""
        return failure_info(self.kind, self.message, self.frames)

    def raised(self, name: str) -> EnvFaultError:
        """Return it as the error of an environment, whose cause is the exception."""
        error = EnvFaultError(f"{name}: {self.message}")
        if self.details:
            error.add_note(self.details)
        error.__cause__ = self.error
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        # Only errors of GEM are raised again in the other process; others may need modules that it cannot import.
        error = self.error if isinstance(self.error, GemError) and _can_be_pickled(self.error) else None
        details = self.details
        if error is None and self.error is not None:
            import traceback

            details = "".join(traceback.format_exception(self.error))[-_LONGEST_MESSAGE:]
        return Failure, (self.kind, self.message, error, details, self.permanent, self.frames)


def _can_be_pickled(error: BaseException) -> bool:
    try:
        return type(pickle.loads(pickle.dumps(error))) is type(error)
    except Exception:  # noqa: BLE001 - an exception's own pickling may raise anything
        return False


class WorkerFailureError(GemError):
    """An environment in a worker failed, or its worker did.

    Args:
        failure: The failure.
    """

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure
