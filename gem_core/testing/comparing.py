"""Convert results of an environment to plain data, compare them between runs, and find what JSON would lose."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from gem_core.records.plain_json import to_plain
from gem_core.testing.findings import shown


def play(
    reset: Callable[[], Any] | None, step: Callable[[Any], Any], actions: Sequence[Any]
) -> Iterator[dict[str, Any]]:
    """Play one episode and yield each result as plain data, until its end or the last action."""
    if reset is not None:
        yield record_of(reset())
    for action in actions:
        result = step(action)
        yield record_of(result)
        if result[2] or result[3]:
            return


def record_of(result: Any) -> dict[str, Any]:
    """Return the result of a reset or a step as plain data, without durations."""
    observation, *middle, info = result
    record = {"observation": to_plain(observation), "info": to_plain(info)}
    record.update(zip(("reward", "terminated", "truncated"), map(to_plain, middle), strict=False))
    if isinstance(record["info"].get("episode"), dict):
        record["info"]["episode"].pop("t", None)  # seconds of wall-clock time, as in Gymnasium
    return record


def is_image(value: Any) -> bool:
    """Tell whether a value is a PIL image, without importing PIL."""
    pil = sys.modules.get("PIL.Image")
    return pil is not None and isinstance(value, pil.Image)


def differences(what: str, expected: Sequence[Any], found: Sequence[Any], first_step: int = 0) -> Iterator[str]:
    """Yield a sentence for the first difference of two recorded episodes.

    Args:
        what: How the sentence begins, as in ``"a used instance differs"``.
        expected: One recording.
        found: The other.
        first_step: Number of the step that the first record belongs to; 0 is the reset.
    """
    for index, (left, right) in enumerate(zip(expected, found, strict=False), first_step):
        where = difference(left, right)
        if where is not None:
            yield f"{what} at {f'step {index}' if index else 'reset'}{where}"
            return
    if len(expected) != len(found):
        lengths = (len(episode) + first_step - 1 for episode in (expected, found))
        yield "{} one has {} steps and the other {}".format(what, *lengths)


def difference(left: Any, right: Any, path: str = "") -> str | None:
    """Return where two pieces of plain data first differ, and the values there; None if they are equal."""
    if isinstance(left, dict) and isinstance(right, dict):
        for key in left | right:
            if key not in left or key not in right:
                return f"{path} {key!r} is there only once"
            found = difference(left[key], right[key], f"{path} {key}")
            if found is not None:
                return found
        return None
    if left == right and isinstance(left, bool) == isinstance(right, bool):
        return None
    return f"{path}: {shown(left)}, then {shown(right)}"


def json_loss(value: Any, path: str = "it") -> str | None:
    """Return what JSON cannot represent in a value, except images; None if it can represent all."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(value, dict) and not isinstance(key, str):
                return f"{path} has the key {shown(key)}, which is not a string"
            found = json_loss(item, f"{path}[{key!r}]")
            if found is not None:
                return found
    elif isinstance(value, float) and not math.isfinite(value):
        return f"{path} is {value!r}"
    elif not (value is None or isinstance(value, str | float | int) or is_image(value)):
        return f"{path} is a {type(value).__name__}"
    return None
