"""Compare what a program printed with what was expected, as programming contests do."""

from __future__ import annotations

import math
from typing import Any


def same_output(printed: str, expected: str, float_tolerance: float | None = None) -> bool:
    """Tell whether an output is accepted: white space at the ends of lines, and around all of them, does not count.

    Args:
        printed: Standard output of the program.
        expected: Output of the test.
        float_tolerance: Compare word by word, numbers being equal that differ by at most this, or by at most this part
            of the expected one. Two whole numbers must be equal. None compares text.

    Source: the comparisons of Codeforces' testlib (lcmp, rcmp).
    """
    if printed == expected:
        return True
    if float_tolerance is not None:
        return _same_tokens(printed.split(), expected.split(), float_tolerance)
    return _lines(printed) == _lines(expected)


def same_value(returned: Any, expected: Any, float_tolerance: float | None = None) -> bool:
    """Tell whether a function returned what was expected, where the expected value comes from JSON.

    JSON has lists alone, so tuples count as lists, and keys of mappings as their text. Numbers are equal as in Python,
    and truth values are no numbers.
    """
    if isinstance(returned, bool) or isinstance(expected, bool):
        return returned is expected
    if isinstance(returned, list | tuple) and isinstance(expected, list | tuple):
        pairs = zip(returned, expected, strict=False)
        return len(returned) == len(expected) and all(same_value(*pair, float_tolerance) for pair in pairs)
    if isinstance(returned, dict) and isinstance(expected, dict):
        mine, theirs = ({str(key): value for key, value in side.items()} for side in (returned, expected))
        return mine.keys() == theirs.keys() and all(same_value(mine[k], theirs[k], float_tolerance) for k in mine)
    numbers = isinstance(returned, int | float) and isinstance(expected, int | float)
    if numbers and float_tolerance is not None and (isinstance(returned, float) or isinstance(expected, float)):
        try:
            return _close(float(returned), float(expected), float_tolerance)
        except OverflowError:  # a whole number that no float holds
            return False
    return bool(returned == expected)


def _lines(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip().splitlines()]


def _same_tokens(printed: list[str], expected: list[str], tolerance: float) -> bool:
    if len(printed) != len(expected):
        return False
    return all(mine == theirs or _same_number(mine, theirs, tolerance) for mine, theirs in zip(printed, expected))  # noqa: B905


def _same_number(printed: str, expected: str, tolerance: float) -> bool:
    if _is_whole(printed) and _is_whole(expected):
        return printed.lstrip("+") == expected.lstrip("+")
    # float() takes underscores and digits of other scripts, which no contest does.
    if "_" in printed or not printed.isascii():
        return False
    try:
        return _close(float(printed), float(expected), tolerance)
    except ValueError:
        return False


def _is_whole(token: str) -> bool:
    return token.isascii() and token.lstrip("+-").isdigit()


def _close(value: float, expected: float, tolerance: float) -> bool:
    if math.isnan(value) or math.isnan(expected):
        return False
    return math.isclose(value, expected, rel_tol=0.0, abs_tol=tolerance * max(1.0, abs(expected)))
