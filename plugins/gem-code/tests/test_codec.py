"""Plain data crosses to the tests and back; nothing else does."""

from __future__ import annotations

import collections
import enum
import json
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_code.inside.codec import MAX_DEPTH, NotDataError, decode, encode


def dumps(value: Any) -> str:
    """Return a value as text."""
    return json.dumps(encode(value))


def loads(text: str) -> Any:
    """Return the value that ``dumps`` wrote."""
    return decode(json.loads(text))


_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
    | st.complex_numbers(allow_nan=False)
    | st.decimals(allow_nan=False)
    | st.fractions()
    | st.dates()
    | st.times()
    | st.datetimes()
    | st.timedeltas()
)
_KEYS = st.integers() | st.text() | st.booleans() | st.tuples(st.integers(), st.text())
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: (
        st.lists(inner)
        | st.tuples(inner, inner)
        | st.dictionaries(_KEYS, inner)
        | st.sets(_KEYS)
        | st.frozensets(_KEYS)
        | st.builds(collections.deque, st.lists(inner))
    ),
    max_leaves=12,
)


def _types(value: Any) -> Any:
    if isinstance(value, list | tuple | collections.deque):
        return type(value), [_types(item) for item in value]
    if isinstance(value, dict):
        return type(value), [(_types(key), _types(item)) for key, item in value.items()]
    return type(value)


@given(_VALUES)
def test_data_comes_back_the_same(value: Any) -> None:
    """In value and in type, all the way down, as one line of ASCII."""
    text = dumps(value)
    assert text.isascii()
    assert "\n" not in text
    back = loads(text)
    assert back == value
    assert _types(back) == _types(value)


def test_rare_values_come_back() -> None:
    """Long numbers, infinities, ranges, broken Unicode."""
    for value in (10**400, -(10**5000), math.inf, -math.inf, -0.0, range(3, 99, 4), "\ud800", bytearray(b"x")):
        back = loads(dumps(value))
        assert type(back) is type(value)
        assert back == value
    assert str(loads(dumps(-0.0))) == "-0.0"
    assert math.isnan(loads(dumps(math.nan)))


class Colour(enum.IntEnum):
    """A subclass of int."""

    RED = 1


def test_subclasses_come_as_what_they_hold() -> None:
    """No class of the program's own arrives."""
    pair = collections.namedtuple("pair", "a b")
    text = type("Text", (str,), {"__eq__": lambda self, other: True, "__hash__": str.__hash__})
    assert loads(dumps(pair(1, 2))) == (1, 2)
    assert loads(dumps(pair(1, 2))).b == 2
    assert type(loads(dumps(pair(1, 2)))) is not pair
    assert type(loads(dumps(text("x")))) is str
    assert type(loads(dumps(Colour.RED))) is int
    assert loads(dumps(collections.defaultdict(list, a=[1]))) == {"a": [1]}
    assert loads(dumps(collections.Counter("aab"))).most_common(1) == [("a", 2)]


def test_iterators_come_as_iterators() -> None:
    """Of at most so many items."""
    assert list(loads(dumps(x * x for x in range(3)))) == [0, 1, 4]
    assert list(loads(dumps({1: 2}.items()))) == [(1, 2)]


def test_what_is_no_data_is_refused() -> None:
    """Objects, functions, and values without an end."""
    deep: list[Any] = []
    for _ in range(MAX_DEPTH + 1):
        deep = [deep]
    circle: list[Any] = []
    circle.append(circle)
    for value in (object(), print, [object()], {"a": print}, deep, circle):
        with pytest.raises(NotDataError):
            dumps(value)
    with pytest.raises(NotDataError, match="a value of type object"):
        dumps(object())


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner) | st.dictionaries(st.sampled_from("itszdCqIcFrfbBDTNh") | st.text(), inner, max_size=2)
    ),
    max_leaves=10,
)


@given(_JSON)
def test_whatever_is_read_is_data_or_an_error(value: Any) -> None:
    """What a program writes in place of an answer raises ``ValueError`` at worst."""
    try:
        loads(json.dumps(value))
    except ValueError:
        return


@pytest.mark.parametrize(
    "text", ['{"i":"x"}', '{"t":5}', '{"T":["now","x"]}', '{"F":[1,0]}', '{"N":["a b",["c"],[1]]}', '{"h":[1,2]}']
)
def test_damaged_text_is_a_value_error(text: str) -> None:
    """However it is damaged."""
    with pytest.raises(ValueError):  # noqa: PT011 - the messages are Python's
        loads(text)
