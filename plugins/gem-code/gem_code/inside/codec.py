"""Plain data as JSON text that keeps Python's types; runs inside the sandbox too, with the standard library alone.

What a program under test returns crosses to the tests as *data*, never as an object: no method of the program's own, as
an ``__eq__`` that always says yes, is there when the tests look at it.
"""

from __future__ import annotations

import collections
import datetime
import decimal
import fractions
import itertools
import json
from collections.abc import Iterator
from typing import Any

MAX_DEPTH = 100
"""Levels of nesting that are passed on; deeper ones are refused."""

MAX_ITEMS = 1_000_000
"""Items that are taken from an iterator, which may have no end."""

_BIG = 10**300  # from here on an int is written in base 16, which has no limit of digits


class NotDataError(TypeError):
    """A value that is no plain data."""


class ProgramError(Exception):
    """The program raised an error of its own making, or returned what cannot be looked at here."""


class Opaque:
    """Stands for an object of the program's, of which only its truth is known.

    Args:
        kind: Name of its type.
        truth: What ``bool`` says of it.
    """

    def __init__(self, kind: str, truth: bool) -> None:
        self._kind, self._truth = kind, truth

    def __bool__(self) -> bool:
        return self._truth

    def __hash__(self) -> int:
        return id(self)

    def _refuse(self, *_: Any) -> Any:
        raise ProgramError(f"the program returned a value of type {self._kind}, which is no plain data")

    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __getattr__ = _refuse
    __call__ = __iter__ = __len__ = __contains__ = __getitem__ = _refuse


def dumps(value: Any, *, opaque: bool = False) -> str:
    """Return a value as one line of ASCII; sets are ordered, so that equal ones give equal text.

    Args:
        value: Plain data.
        opaque: Whether what is none crosses as its type's name and its truth.

    Raises:
        NotDataError: It, or something in it, is no plain data, or is nested too deeply.
    """
    return json.dumps(encode(value, opaque=opaque), separators=(",", ":"))


def loads(text: str) -> Any:
    """Return the value that ``dumps`` wrote.

    Raises:
        ValueError: The text is not of that form; whatever is wrong with it.
    """
    try:
        return decode(json.loads(text))
    except ValueError:
        raise
    except (TypeError, LookupError, ArithmeticError, RecursionError, AttributeError) as error:
        raise ValueError(f"this is no encoded value: {type(error).__name__}: {error}") from error


def encode(value: Any, depth: int = 0, *, opaque: bool = False) -> Any:
    """Return a value as what JSON can hold: text, numbers, lists, and one-entry mappings that name a type."""
    kind = type(value)
    if value is None or kind is bool or kind is str:
        return value
    if kind is int:
        return value if -_BIG < value < _BIG else {"i": hex(value)}
    if kind is float:
        return value if value - value == 0 else {"f": repr(value)}
    if depth >= MAX_DEPTH:
        raise NotDataError(f"values nested more than {MAX_DEPTH} deep")
    depth += 1
    if kind is list:
        return [encode(item, depth, opaque=opaque) for item in value]
    if isinstance(value, tuple):
        return {"t": [encode(item, depth, opaque=opaque) for item in value]}
    if isinstance(value, dict):
        pairs = [[encode(key, depth, opaque=opaque), encode(item, depth, opaque=opaque)] for key, item in value.items()]
        return {"C" if isinstance(value, collections.Counter) else "d": pairs}
    if isinstance(value, set | frozenset):
        items = [encode(item, depth, opaque=opaque) for item in value]
        return {"s" if isinstance(value, set) else "z": sorted(items, key=json.dumps)}
    if isinstance(value, list):
        return [encode(item, depth, opaque=opaque) for item in value]
    return _encode_rare(value, depth, opaque)


def _encode_rare(value: Any, depth: int, opaque: bool) -> Any:  # noqa: C901 - one branch for each type
    if isinstance(value, bytes | bytearray):
        return {"b" if isinstance(value, bytes) else "B": bytes(value).hex()}
    if isinstance(value, complex):
        return {"c": [encode(value.real), encode(value.imag)]}
    if isinstance(value, range):
        return {"r": [encode(value.start), encode(value.stop), encode(value.step)]}
    if isinstance(value, collections.deque):
        return {"q": [encode(item, depth, opaque=opaque) for item in value]}
    if isinstance(value, fractions.Fraction):
        return {"F": [encode(value.numerator), encode(value.denominator)]}
    if isinstance(value, decimal.Decimal):
        return {"D": str(value)}
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return {"T": [_temporal(value), value.isoformat()]}
    if isinstance(value, datetime.timedelta):
        return {"T": ["timedelta", [value.days, value.seconds, value.microseconds]]}
    if type(value).__module__.partition(".")[0] == "numpy" and hasattr(value, "tolist"):
        return encode(value.tolist(), depth, opaque=opaque)
    for base in (str, int, float):
        if isinstance(value, base):
            return encode(base(value), depth, opaque=opaque)
    if isinstance(value, collections.abc.KeysView | collections.abc.ValuesView | collections.abc.ItemsView):
        return [encode(item, depth, opaque=opaque) for item in value]
    if isinstance(value, Iterator):
        items = [encode(item, depth, opaque=opaque) for item in itertools.islice(value, MAX_ITEMS + 1)]
        if len(items) > MAX_ITEMS:
            raise NotDataError(f"an iterator of more than {MAX_ITEMS} items")
        return {"I": items}
    if opaque:
        return {"o": [type(value).__name__, bool(value)]}
    raise NotDataError(f"a value of type {type(value).__name__}")


def decode(value: Any, depth: int = 0) -> Any:
    """Return what ``encode`` was given."""
    if not isinstance(value, list | dict):
        return value
    if depth > 2 * MAX_DEPTH:
        raise ValueError("values are nested too deeply")
    if isinstance(value, list):
        return [decode(item, depth + 1) for item in value]
    ((kind, content),) = value.items()
    if kind in _SEQUENCES:
        return _SEQUENCES[kind](decode(item, depth + 1) for item in content)
    if kind in _SCALARS:
        return _SCALARS[kind](content)
    if kind in ("d", "C"):
        pairs = {decode(key, depth + 1): decode(item, depth + 1) for key, item in content}
        return collections.Counter(pairs) if kind == "C" else pairs
    raise ValueError(f"no type is written as {kind!r}")


def _temporal(value: datetime.date | datetime.time) -> str:
    return next(name for name in ("datetime", "date", "time") if isinstance(value, getattr(datetime, name)))


def _from_temporal(content: Any) -> Any:
    name, value = content
    if name == "timedelta":
        return datetime.timedelta(*value)
    if name not in ("datetime", "date", "time"):
        raise ValueError(f"no type of time is called {name!r}")
    return getattr(datetime, name).fromisoformat(value)


PLAIN: tuple[type, ...] = (
    *(int, float, complex, str, bytes, bytearray, list, tuple, dict, set, frozenset, range),
    *(collections.deque, collections.Counter, decimal.Decimal, fractions.Fraction),
    *(datetime.datetime, datetime.date, datetime.time, datetime.timedelta),
)
"""The types of what comes out of ``decode``, iterators apart."""

_SEQUENCES: dict[str, Any] = {
    "t": tuple,
    "s": set,
    "z": frozenset,
    "q": collections.deque,
    "I": lambda items: iter(list(items)),
    "c": lambda parts: complex(*parts),
    "F": lambda parts: fractions.Fraction(*parts),
    "r": lambda parts: range(*parts),
}
_SCALARS: dict[str, Any] = {
    "i": lambda text: int(text, 16),
    "f": float,
    "b": bytes.fromhex,
    "B": bytearray.fromhex,
    "D": decimal.Decimal,
    "T": _from_temporal,
    "o": lambda content: Opaque(str(content[0]), bool(content[1])),
}
