"""Redact secrets in records, found by names and places where secrets usually are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

BLOT = "***"

_PAIRS = frozenset(["headers", "env"])
"""Names of mappings whose values are secrets more often than not: of requests, and of programs that are started."""

_NAME = re.compile(
    r"(?:.*[_-])?(?:api[_-]?key|(?:access|account|auth|private|secret|subscription)[_-]?key|password|passwd|secret|"
    r"credentials?|authorization|(?:access|api|auth|bearer|refresh|session)[_-]?token|token)",
    re.IGNORECASE,
)
_FLAG = re.compile(rf"(--?(?:{_NAME.pattern}))(?:=(.*))?", re.IGNORECASE | re.DOTALL)
_VARIABLE = re.compile(r"(?:\w+ )?\$\{(?:env:)?\w+\}", re.ASCII)
"""The name of a variable instead of its value, as in ``Bearer ${TOKEN}``."""

_USER = re.compile(r"(?<=://)[^/?#\s@]*@")
_QUERY = re.compile(r"(?<=[?&])([\w.~%-]+=)[^&#\s]+")


def without_secrets(value: Any) -> Any:
    """Return options with secrets redacted.

    Redacted are texts under names such as ``api_key``, ``password`` or ``token``, all in mappings that are called
    ``headers`` or ``env``, what follows a flag such as ``--api-key`` in a list, and in addresses the user with the
    password, and the values of the query. Names of variables, as in ``${TOKEN}``, stay.

    Args:
        value: Names and options as plain JSON, of which nothing is changed.
    """
    if isinstance(value, str):
        return _QUERY.sub(rf"\g<1>{BLOT}", _USER.sub(f"{BLOT}@", value)) if "://" in value else value
    if isinstance(value, Mapping):
        return {name: _redact_item(name, part) for name, part in value.items()}
    if isinstance(value, list):
        parts = [without_secrets(part) for part in value]
        for number, part in enumerate(value):
            flag = _FLAG.fullmatch(part) if isinstance(part, str) else None
            if flag and flag[2] is not None:
                parts[number] = f"{flag[1]}={BLOT}"
            elif flag and number + 1 < len(parts) and isinstance(parts[number + 1], str):
                parts[number + 1] = _redact(value[number + 1])
        return parts
    return value


def _redact_item(name: object, value: Any) -> Any:
    if name in _PAIRS and isinstance(value, Mapping):
        return {key: _redact(part) for key, part in value.items()}
    if isinstance(value, str) and isinstance(name, str) and _NAME.fullmatch(name):
        return _redact(value)
    return without_secrets(value)


def _redact(value: object) -> Any:
    if value is None or isinstance(value, bool) or (isinstance(value, str) and _VARIABLE.fullmatch(value)):
        return value
    return BLOT
