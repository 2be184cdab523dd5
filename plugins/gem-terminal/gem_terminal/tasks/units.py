"""Sizes and durations as Compose and Harbor write them."""

from __future__ import annotations

import math
import re

_SIZE = re.compile(r"([0-9]{1,15}(?:\.[0-9]{1,9})?)\s*([kmgt]?)i?(b?)", re.IGNORECASE)
_POWER = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4}
_DURATION = re.compile(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(us|ms|s|m|h)")
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}


def megabytes(text: str) -> int:
    """Return a size such as ``"512m"``, ``"1.5gb"`` or ``"1048576"`` (bytes) in megabytes of 2**20, rounded up.

    Raises:
        ValueError: It is none; says what was expected.
    """
    found = _SIZE.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"{text[:60]!r} is no size; expected one such as '512m' or '2g'")
    size = float(found[1]) * 1024.0 ** _POWER[found[2].lower()]
    if size > 2**60:
        raise ValueError(f"{text[:60]!r} is too large a size; expected one such as '512m' or '2g'")
    return math.ceil(size / 2**20)


def seconds(text: str) -> float:
    """Return a duration such as ``"1m30s"``, ``"500ms"`` or ``"10"`` (seconds) in seconds.

    Raises:
        ValueError: It is none; says what was expected.
    """
    text = text.strip()
    if re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", text):
        return float(text)
    position, total = 0, 0.0
    while found := _DURATION.match(text, position):
        total += float(found[1]) * _SECONDS[found[2]]
        position = found.end()
    if not text or position < len(text) or len(text) > 60:
        raise ValueError(f"{text[:60]!r} is no duration; expected one such as '30s' or '1m30s'")
    return total
