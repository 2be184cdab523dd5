"""Where in an author's own file something went wrong."""

from __future__ import annotations

import os
import traceback

_OURS = ("gem_core", "importlib", "gymnasium")


def place_of(error: BaseException, package: str) -> str:
    """Return ``file:line`` of the last line of a package that an exception passed through.

    Args:
        error: The exception, with its traceback.
        package: Name of the author's package, or of any module in it.

    Returns:
        The place; of the last line of others where no line of the package took part; ``""`` where there is none.
    """
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return shown_place(error.filename, error.lineno)
    author = package.partition(".")[0]
    place = ""
    by_author = False
    for frame, line in traceback.walk_tb(error.__traceback__):
        top = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if top == author or not (by_author or top in _OURS):
            place = shown_place(frame.f_code.co_filename, line)
            by_author = by_author or top == author
    return place


def shown_place(path: str, line: int) -> str:
    """Return ``file:line``, with a path below the current folder written from there on."""
    try:
        relative = os.path.relpath(path)
    except (OSError, ValueError):  # the current folder is gone, or on another drive
        relative = path
    return f"{path if relative.startswith(os.pardir) else relative}:{line}"
