"""Deadlines fire in order, and not when they were cancelled."""

from __future__ import annotations

import threading
import time

from gem_terminal.deadlines import Deadlines


def test_deadlines_fire_and_cancelled_ones_do_not() -> None:
    """One that is past fires at once, whatever waits for a later one."""
    deadlines, fired, late = Deadlines(), threading.Event(), threading.Event()
    later = deadlines.add(time.monotonic() + 3600, late.set)
    cancelled = deadlines.add(time.monotonic() + 0.2, late.set)
    cancelled.cancel()
    deadlines.add(time.monotonic() - 1, fired.set)
    assert fired.wait(30)
    again = threading.Event()
    deadlines.add(time.monotonic() + 0.3, again.set)
    assert again.wait(30)
    assert not late.is_set()
    later.cancel()


def test_an_action_that_hangs_holds_up_no_other() -> None:
    """Each runs in a thread of its own."""
    deadlines, gate, fired = Deadlines(), threading.Event(), threading.Event()
    deadlines.add(0.0, gate.wait)
    deadlines.add(0.0, fired.set)
    assert fired.wait(30)
    gate.set()
