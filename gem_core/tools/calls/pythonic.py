"""Calls written as calls in Python: ``python(code="…")``, in a list or alone."""

from __future__ import annotations

import re

from gem_core.tools.calls.found import ParsedCall
from gem_core.tools.calls.values import arguments_at

_CALL = re.compile(r"\s*+(?:\[\s*+)?([A-Za-z_][\w-]{0,100}+(?:\.[A-Za-z_][\w-]{0,100}+){0,5})\s*+\(")


def pythonic(text: str, at: int) -> ParsedCall | None:
    """Read the call, or the first of a list of them, at a place; its arguments are literals."""
    opening = _CALL.match(text, at)
    if opening is None:
        return None
    try:
        given, end = arguments_at(text, opening.end())
    except ValueError as error:
        return ParsedCall(opening[1], None, 0, problem=f"its arguments are no literals of Python: {error}"[:220])
    return ParsedCall(opening[1], given, end)
