"""When a request is tried again: waits that grow, with jitter, and what ``Retry-After`` asks for."""

from __future__ import annotations

import asyncio
import email.utils
import math
import random
import time

FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 30.0

_NEVER_AGAIN = (501, 505)


class Clock:
    """Time and chance, in one place so that tests bring their own."""

    def __init__(self) -> None:
        # A generator of its own: jitter must differ between processes and touch nobody's random state.
        self._random = random.Random()

    def now(self) -> float:
        """Return ``time.monotonic()``, in seconds."""
        return time.monotonic()

    def wall(self) -> float:
        """Return the seconds since 1970, as HTTP dates count them."""
        return time.time()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)

    def timeout(self, seconds: float | None) -> asyncio.Timeout:
        """Return an asynchronous context that ends with a ``TimeoutError`` after so many seconds; None for never."""
        return asyncio.timeout(seconds)

    def chance(self, most: float) -> float:
        """Return a random number from 0 to ``most``."""
        return self._random.uniform(0.0, most)


def is_transient(status: int) -> bool:
    """Tell whether the same request may be answered later: on 408, 409, 425, 429, and on faults of the server.

    409 is what servers answer while they take turns at a lock, and what OpenAI's own client tries again.
    """
    return status in (408, 409, 425, 429) or (status >= 500 and status not in _NEVER_AGAIN)


def wait_s(clock: Clock, attempt: int, retry_after: float | None = None) -> float:
    """Return how long to wait after an attempt that failed.

    Args:
        clock: Gives the chance.
        attempt: Number of attempts so far, from 1.
        retry_after: What the server asked for, in seconds; a little chance comes on top, so that not all who were
            sent away come back in one instant.

    Source: "full jitter", https://aws.amazon.com/blogs/architecture/exponential-backoff-and-jitter/.
    """
    if retry_after is not None:
        return retry_after + clock.chance(FIRST_WAIT_S)
    return clock.chance(min(LONGEST_WAIT_S, FIRST_WAIT_S * 2 ** min(attempt - 1, 16)))


def retry_after_s(header: str | None, wall: float) -> float | None:
    """Return the seconds that a ``Retry-After`` header asks for, by number or by date; None if it says nothing.

    Source: RFC 9110, section 10.2.3.
    """
    if header is None:
        return None
    try:
        seconds = float(header)
    except ValueError:
        try:
            seconds = email.utils.parsedate_to_datetime(header).timestamp() - wall
        except (ValueError, OverflowError):
            return None
    return max(seconds, 0.0) if math.isfinite(seconds) else None
