"""What the processes of a study run in the tests: in a module that they can import."""

from __future__ import annotations

from typing import Any


def double(number: int) -> dict[str, Any]:
    """Return twice a number; 3 fails."""
    if number == 3:
        raise ValueError("three")
    return {"double": 2 * number}
