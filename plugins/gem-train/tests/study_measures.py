"""What a process of a study measures in the tests: in a module that it can import."""

from __future__ import annotations

import sys
import threading
from typing import Any

from gem_train.learner.training import Training


def count_turns(training: Training) -> dict[str, Any]:
    """Return how many turns an evaluation takes."""
    return {"turns": sum(len(seat.turns) for seat in training.evaluate())}


def wait_forever(training: Training) -> dict[str, Any]:
    """Say so, and never return."""
    sys.stdout.write("measuring\n")
    sys.stdout.flush()
    threading.Event().wait()
    return {}
