"""``Failure``: why an environment has no result, as plain data for records and for other processes."""

from __future__ import annotations

import os
import pickle
import sys
import traceback
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

_MOST_FRAMES = 3
_NOT_THE_AUTHORS = frozenset(["gem_core", "gymnasium", *sys.stdlib_module_names])

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
        message = f"{where} raised {shown_error(error)}"[:_LONGEST_MESSAGE]
        permanent = making and isinstance(error, _PERMANENT)
        return cls("exception", message, error, permanent=permanent, frames=author_frames(error))

    @classmethod
    def timeout(cls, limit_s: float) -> Failure:
        """Return the failure of a step or reset that took too long."""
        return cls("timeout", f"a step or reset took longer than step_timeout, {limit_s:g} s")

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


def shown_error(error: BaseException) -> str:
    """Return the type and the text of an exception, whose own methods may raise anything."""
    try:
        return f"{type(error).__name__}: {error}" if str(error) else repr(error)
    except Exception:  # noqa: BLE001 - see above
        return f"{type(error).__name__}, which cannot be shown"


def failure_info(kind: str, message: str, frames: list[str]) -> dict[str, Any]:
    """Return ``info["error"]``: ``kind``, ``message``, and ``frames`` if there are any."""
    return {"kind": kind, "message": message} | ({"frames": frames} if frames else {})


def author_frames(error: BaseException) -> list[str]:
    """Return the last frames of the author's code that an exception passed through, as ``file:line, in name: source``.

    The author's is all code but that of Python, Gymnasium and GEM's core. Where the exception passed through none, its
    cause counts.
    """
    each: BaseException | None = error
    seen: set[int] = set()
    while each is not None and id(each) not in seen:
        seen.add(id(each))
        frames = [
            (frame, line)
            for frame, line in traceback.walk_tb(each.__traceback__)
            if str(frame.f_globals.get("__name__", "")).partition(".")[0] not in _NOT_THE_AUTHORS
        ]
        if frames:
            told = traceback.StackSummary.extract(iter(frames[-_MOST_FRAMES:]))
            return [
                f"{shown_place(one.filename, one.lineno or 0)}, in {one.name}: {one.line or '':.200}" for one in told
            ]
        each = each.__cause__ or each.__context__
    return []


def shown_place(path: str, line: int) -> str:
    """Return ``file:line``, with a path below the current folder written from there on."""
    try:
        relative = os.path.relpath(path)
    except (OSError, ValueError):  # the current folder is gone, or on another drive
        relative = path
    return f"{path if relative.startswith(os.pardir) else relative}:{line}"
