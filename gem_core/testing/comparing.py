"""Convert results of an environment to plain data, compare them between runs, and find what JSON would lose."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gem_core.testing.findings import shown

_TOO_LARGE = 10**4300
"""Python writes whole numbers of no more than 4,300 digits."""


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
    record = {"observation": plain(observation), "info": plain(info)}
    record.update(zip(("reward", "terminated", "truncated"), map(plain, middle), strict=False))
    _drop_durations(record["info"])
    return record


def _drop_durations(info: Any) -> None:
    if not isinstance(info, dict):
        return
    if isinstance(info.get("episode"), dict):
        info["episode"].pop("t", None)  # seconds of wall-clock time, as in Gymnasium
    if isinstance(info.get("agents"), dict):
        for own in info["agents"].values():
            _drop_durations(own)


def plain(value: Any) -> Any:
    """Copy a value into plain data: equal values stay equal and different ones different, in any process."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str | int):
        return str(value) if isinstance(value, str) else int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return {"array": plain(value.tolist()), "dtype": str(value.dtype)}
    if isinstance(value, set | frozenset):
        return {"set": sorted(map(repr, value))}
    if is_image(value):
        return {"image": [value.mode, *value.size], "sha256": hashlib.sha256(value.tobytes()).hexdigest()}
    return {"object": f"{type(value).__module__}.{type(value).__qualname__}"}


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


def json_loss(value: Any) -> str | None:
    """Return what JSON cannot represent in a value, except images; None if it can represent all."""
    value = _without_images(value)
    try:
        kept = json.loads(json.dumps(value, allow_nan=False)) == value
    except (TypeError, ValueError, RecursionError) as error:
        return _culprit(value, "") or f"{type(error).__name__}: {error}"
    return None if kept else _culprit(value, "") or "it is not equal to itself after a round trip"


def mutable_parts(value: Any) -> Iterator[Any]:
    """Yield every dictionary, list and array within a value."""
    if isinstance(value, Mapping):
        yield value
        for item in value.values():
            yield from mutable_parts(item)
    elif isinstance(value, list | tuple):
        if isinstance(value, list):
            yield value
        for item in value:
            yield from mutable_parts(item)
    elif isinstance(value, np.ndarray):
        yield value


def difference(left: Any, right: Any, path: str = "") -> str | None:
    """Return where two pieces of plain data first differ, and the values there; None where they are equal."""
    if isinstance(left, dict) and isinstance(right, dict):
        for key in [*left, *(key for key in right if key not in left)]:
            if key not in left or key not in right:
                return f"{path} {key!r} is there only once"
            found = difference(left[key], right[key], f"{path} {key}")
            if found is not None:
                return found
        return None
    if left == right and isinstance(left, bool) == isinstance(right, bool):
        return None
    return f"{path}: {shown(left)}, then {shown(right)}"


def _without_images(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_images(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_images(item) for item in value]
    return "<image>" if is_image(value) else value


def _culprit(value: Any, path: str) -> str | None:
    where = path or "the whole"
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(value, dict) and not isinstance(key, str):
                return f"{where} has the key {shown(key)}, which is not a string"
            found = _culprit(item, f"{path}[{key!r}]")
            if found is not None:
                return found
        return None
    if isinstance(value, float) and not math.isfinite(value):
        return f"{where} is {value!r}"
    if isinstance(value, int) and abs(value) >= _TOO_LARGE:
        return f"{where} is an int of too many digits"
    return None if value is None or isinstance(value, str | float | int) else f"{where} is a {type(value).__name__}"
