"""``close_all``: closes environments all at once, and waits for them for a limited time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable
from typing import Any

from gem_core.background import on_background_loop

logger = logging.getLogger("gem_core")

CLOSING_S = 5.0
"""Seconds that an environment may take to close."""

_closing: set[threading.Thread] = set()
"""Threads in which something closes."""


def close_all(resources: Iterable[Any], limit_s: float = CLOSING_S) -> int:
    """Close environments, each in a thread of its own; an error is logged.

    On the library's own event loop it does not wait, since an environment may need that loop to close;
    ``wait_for_closing`` does.

    Args:
        resources: Objects with a method ``close``.
        limit_s: Seconds to wait.

    Returns:
        How many had not ended by then.
    """
    threads = [threading.Thread(target=_close, args=(each,), name="gem-close", daemon=True) for each in resources]
    for thread in threads:
        thread.start()
    _closing.difference_update([thread for thread in list(_closing) if not thread.is_alive()])
    _closing.update(threads)
    return 0 if on_background_loop() else _join(threads, limit_s)


def wait_for_closing(limit_s: float = CLOSING_S) -> int:
    """Wait for all that is closing in this process; return how many had not ended after the limit, each only once."""
    if on_background_loop():
        return 0
    threads = list(_closing)
    left = _join(threads, limit_s)
    _closing.difference_update(threads)
    return left


def _join(threads: list[threading.Thread], limit_s: float) -> int:
    deadline = time.monotonic() + limit_s
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))
    return sum(thread.is_alive() for thread in threads if thread is not threading.current_thread())


def _close(resource: Any) -> None:
    try:
        resource.close()
    except BaseException:
        logger.warning("gem: closing an environment failed", exc_info=True)
