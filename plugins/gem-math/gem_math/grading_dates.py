"""Reads days of the calendar and times of the clock."""

from __future__ import annotations

import re

from gem_math.grading_tokens import text_inside

_MONTHS = ["january", "february", "march", "april", "may", "june", "july", "august", "september", "october", "november",
           "december"]  # fmt: skip
_MONTH = r"([A-Za-z]{3,9})\.?"
_DAY = r"(?:the\s+)?(\d{1,2})(?:\s*\^?\s*\{?\s*(?:st|nd|rd|th)\s*\}?)?"
_WEEKDAY = r"(?:(?:mon|tues|wednes|thurs|fri|satur|sun)day\s*,?\s*)?"
_MONTH_FIRST = re.compile(rf"^(?:on\s+)?{_WEEKDAY}{_MONTH}\s+{_DAY}(?:\s*,?\s*(\d{{4}}))?$", re.IGNORECASE)
_DAY_FIRST = re.compile(rf"^(?:on\s+)?{_WEEKDAY}{_DAY}\s+(?:of\s+)?{_MONTH}(?:\s*,?\s*(\d{{4}}))?$", re.IGNORECASE)
_DIGITS = re.compile(r"^(\d{4})-(\d\d)-(\d\d)$")
_MAY_BE_DAY = re.compile(r"(?:.{0,10}[A-Za-z]{3}|\d{4}-)")
_TIME = re.compile(r"(\d{1,2})(:\d\d)?\s*([ap])\.?\s?m\.?", re.IGNORECASE)


def time_of(text: str) -> str | None:
    r"""Return a time before or after noon in one spelling, as in ``3:00 pm``; None where the text is no time.

    Args:
        text: The answer, after ``clean``, with ``\text{}`` or without.
    """
    if text[-1:] not in {"m", "M", ".", "}"}:
        return None
    match = _TIME.fullmatch(text_inside(text))
    # 3am without any mark is a product.
    if match is None or not (match[2] or re.search(r"[\s.A-Z]|\\text", text)):
        return None
    return f"{match[1]}{match[2] or ':00'} {match[3].lower()}m"


def date_of(text: str) -> str | None:
    """Return a day in one spelling, as in ``date 7 4 2020`` or ``date 7 4``; None where the text is no day."""
    text = text.strip()
    if not _MAY_BE_DAY.match(text):
        return None
    if match := _DIGITS.match(text):
        return _date(int(match[2]), int(match[3]), match[1])
    if match := _MONTH_FIRST.match(text):
        return _date(_month(match[1]), int(match[2]), match[3])
    if match := _DAY_FIRST.match(text):
        return _date(_month(match[2]), int(match[1]), match[3])
    return None


def _month(name: str) -> int:
    """Return the number of a month, whose name may be cut to three letters or more; 0 of anything else."""
    name = name.lower()
    return next((number for number, month in enumerate(_MONTHS, 1) if month.startswith(name)), 0)


def _date(month: int, day: int, year: str | None) -> str | None:
    if not (1 <= month <= 12 and 1 <= day <= 31):
        return None
    return f"date {month} {day}" + (f" {year}" if year else "")
