"""What the processes of a study run in the tests: in a module that they can import."""

from __future__ import annotations

import sys
import threading
from typing import Any


def double(number: int) -> dict[str, Any]:
    """Return twice a number; 3 fails."""
    if number == 3:
        raise ValueError("three")
    return {"double": 2 * number}


def wait_forever() -> dict[str, Any]:
    """Say so, and never return."""
    sys.stdout.write("measuring\n")
    sys.stdout.flush()
    threading.Event().wait()
    return {}
