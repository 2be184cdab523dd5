"""Observations without what they repeat: views of a history repeat it in every turn."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from typing import Any

_SAME = "__same__"
_SHORTEST = 200
"""Texts that have fewer characters in common are written whole, so that short records can be read by eye."""


def folded(observations: Sequence[Any]) -> Iterator[Any]:
    """Yield observations, each without what it has in common with the beginning of the one before.

    A text becomes ``{"__same__": 1200, "rest": "…"}``, with a number of characters; a list of messages or of parts the
    same with a number of items. What has little in common stays as it is.
    """
    before: Any = None
    for observation in observations:
        same = _in_common(before, observation)
        yield {_SAME: same, "rest": observation[same:]} if same else observation
        before = observation


def unfolded(observation: Any, before: Any) -> Any:
    """Return an observation that may be folded.

    Args:
        observation: As it was read.
        before: The observation before it, unfolded.

    Raises:
        ValueError: It refers to more than the one before has, or is of another kind.
    """
    if not isinstance(observation, dict):
        return observation
    same, rest = observation[_SAME], observation["rest"]
    if type(rest) is not type(before) or type(same) is not int or not 0 <= same <= len(before):
        raise ValueError(f"an observation repeats {same!r} of one that does not have it")
    return before[:same] + rest


def _in_common(before: Any, observation: Any) -> int:
    """Return how many characters or items two observations begin with in common; 0 where that is not worth it."""
    if isinstance(before, list) and isinstance(observation, list):
        most = min(len(before), len(observation))
        return next((place for place in range(most) if before[place] != observation[place]), most)
    if not isinstance(before, str) or not isinstance(observation, str):
        return 0
    if observation.startswith(before):  # the first observation stands twice, and many views append
        return len(before) if len(before) >= _SHORTEST else 0
    if len(before) < _SHORTEST or not observation.startswith(before[:_SHORTEST]):
        return 0  # most do: what follows costs more than all else that is written of a turn
    lengths = range(1, min(len(before), len(observation)) + 1)
    same = bisect_left(lengths, True, key=lambda length: not before.startswith(observation[:length]))
    # Whole lines, where those are enough: a search of the file then finds what stands in a line.
    lines = observation.rfind("\n", 0, same) + 1
    same = lines if lines >= _SHORTEST else same
    return same if same >= _SHORTEST else 0
