"""Reading the reward files of Harbor: ``reward.json``, which takes precedence, and ``reward.txt``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

REWARD_FILES = ("reward.json", "reward.txt")
"""Their names in ``/logs/verifier``, in the order of precedence."""

MOST_BYTES = 1_000_000
"""A reward file that is larger is none."""


class RewardFileError(ValueError):
    """A reward file is there, and cannot be read; the message says what is wrong with it."""


def read_rewards(files: Mapping[str, bytes], *, json_written: bool = True) -> dict[str, float] | None:
    """Return the numbers of the reward file, or None where there is none.

    Args:
        files: Contents of what is in ``/logs/verifier``, by name.
        json_written: Whether the task's tests write ``reward.json``, as far as their text shows. If they do not, and
            there is a ``reward.txt``, a ``reward.json`` is another program's, and is passed over.

    Raises:
        RewardFileError: It cannot be read; the other file is not looked at then.
    """
    names = [name for name in REWARD_FILES if name in files]
    if len(names) == len(REWARD_FILES) and not json_written:
        names = names[1:]
    if not names:
        return None
    name = names[0]
    content = files[name]
    if len(content) > MOST_BYTES:
        raise RewardFileError(f"{name} has {len(content):,} bytes; at most {MOST_BYTES:,} are read")
    try:
        text = content.decode("utf-8-sig").strip()
    except UnicodeDecodeError as error:
        raise RewardFileError(f"{name} is not UTF-8 text: {error.reason}") from None
    if not text:
        raise RewardFileError(f"{name} is empty")
    return _from_json(text) if name.endswith(".json") else {"reward": _number(name, text)}


def score_of(rewards: Mapping[str, float]) -> float:
    """Return the one number that stands for all: ``reward``, or the only one, or else their mean."""
    if "reward" in rewards:
        return rewards["reward"]
    return math.fsum(value / len(rewards) for value in rewards.values())


def _from_json(text: str) -> dict[str, float]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RewardFileError(f"reward.json is not JSON: {str(error)[:200]}") from None
    if not isinstance(found, dict) or not found:
        raise RewardFileError(f"reward.json must be an object of names and numbers, not {_shown(found)}")
    rewards = {}
    for name, value in found.items():
        if not isinstance(value, int | float):  # a bool counts as 0 or 1, as Harbor has it
            raise RewardFileError(f"reward.json has {_shown(value)} for {name[:100]!r}; each must be a number")
        rewards[name] = _number("reward.json", value)
    return rewards


def _number(name: str, value: str | float) -> float:
    try:
        number = float(value)
    except (ValueError, OverflowError):
        raise RewardFileError(f"{name} has {_shown(value)}; it must be one number") from None
    if not math.isfinite(number):
        raise RewardFileError(f"{name} has {number}; it must be a finite number")
    return number


def _shown(value: object) -> str:
    """Show the beginning of a value; its kind, where showing it could take long or fail."""
    return repr(value[:100]) if isinstance(value, str) else f"a value of type {type(value).__name__}"
