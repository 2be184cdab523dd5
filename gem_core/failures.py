"""Describe exceptions for records: kind, message, and where in the author's code they came from."""

from __future__ import annotations

import os
import sys
import traceback
from typing import Any

_MOST_FRAMES = 3
_NOT_THE_AUTHORS = frozenset(["gem_core", "gymnasium", *sys.stdlib_module_names])


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
