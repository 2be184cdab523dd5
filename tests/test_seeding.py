"""Seeds: the stable hash is pinned, and generators start and go on where they should."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.env.seeding import (
    SEED_LIMIT,
    checked_seed,
    fresh_seed,
    next_seed,
    stable_hash,
    start_generator,
)
from gem_core.errors import ArgumentError

PARTS = st.lists(st.none() | st.integers() | st.text(st.characters(), max_size=8), max_size=4).map(tuple)


@pytest.mark.parametrize(
    ("parts", "value"),
    [
        ((), 5200090174105316),
        ((None,), 6789036101581405),
        ((0,), 717302778497614),
        (("a", "b"), 7828254425315895),
        (("ab",), 4110113354703948),
        ((7, "actions"), 3953729934058449),
        (("ä\ud800",), 1987088982610479),
    ],
)
def test_stable_hash_is_pinned(parts: Any, value: int) -> None:
    """The hash is the same in every process, on every machine, in every release."""
    assert stable_hash(*parts) == value


@given(PARTS, PARTS)
def test_stable_hash_tells_parts_apart(first: Any, second: Any) -> None:
    """Different lists of parts have different hashes, all below 2**53."""
    assert (stable_hash(*first) == stable_hash(*second)) == (first == second)
    assert 0 <= stable_hash(*first) < 2**53


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (("a", "b"), ("ab",)),
        (("a\x1fstr:b",), ("a", "b")),
        (("a", ""), ("a",)),
        ((1,), ("1",)),
        ((None,), ("None",)),
        ((12,), (1, 2)),
    ],
)
def test_stable_hash_keeps_parts_separate(first: Any, second: Any) -> None:
    """Neither joining parts nor changing their kind gives the same hash."""
    assert stable_hash(*first) != stable_hash(*second)


def test_stable_hash_takes_what_equals_a_number_or_text() -> None:
    """A number of NumPy and a subclass of str count as what they equal."""
    assert stable_hash(np.int64(3), type("Word", (str,), {})("a")) == stable_hash(3, "a")


def test_stable_hash_refuses_fractions() -> None:
    """A float has no stable text, so it is not hashed."""
    with pytest.raises(TypeError):
        stable_hash(1.5)  # type: ignore[arg-type]


def test_next_seed_is_pinned() -> None:
    """The seeds of later episodes stay the same in every release."""
    assert (next_seed(0), next_seed(1)) == (1543160130404687, 6596710130057340)


def test_next_seed_goes_through_all_seeds() -> None:
    """The step meets the conditions of Hull and Dobell, so that a stream has 2**53 episodes before it repeats."""
    increment = next_seed(0)
    multiplier = (next_seed(1) - increment) % SEED_LIMIT
    assert increment % 2 == 1
    assert multiplier % 4 == 1


@given(st.integers(0, 2**200))
def test_next_seed_stays_below_the_limit(seed: int) -> None:
    """Whatever a stream starts from, its later seeds are exact in JSON."""
    assert 0 <= next_seed(seed) < SEED_LIMIT


def test_fresh_seeds_differ() -> None:
    """Fresh seeds come from entropy."""
    seeds = [fresh_seed() for _ in range(50)]
    assert len(set(seeds)) == 50
    assert max(seeds) < SEED_LIMIT


@pytest.mark.parametrize("seed", [-1, True, False, 1.5, 1.0, "x", "1", b"1", [1], np.float64(1)])
def test_bad_seed_is_refused(seed: Any) -> None:
    """A seed is a whole number from 0 up, and no truth value."""
    with pytest.raises(ArgumentError) as caught:
        checked_seed(seed)
    assert str(caught.value) == f"seed must be a whole number from 0 up, not {seed!r}"


def test_seed_of_numpy_becomes_an_int() -> None:
    """A NumPy integer is taken as the number it is."""
    assert type(checked_seed(np.uint32(7))) is int


def test_stream_is_pinned() -> None:
    """What a seed draws stays the same in every release."""
    generator = start_generator(None, 0)
    assert generator.integers(0, 1000, 5).tolist() == [987, 73, 235, 773, 630]
    assert generator.random() == 0.19846314095360718


def test_generator_starts_in_place() -> None:
    """A used generator that is started again is the same object at the start of the stream."""
    generator = start_generator(None, 5)
    first = generator.integers(0, 2**31, 7, dtype=np.int32).tolist()
    assert start_generator(generator, 5) is generator
    assert generator.integers(0, 2**31, 7, dtype=np.int32).tolist() == first


def test_near_seeds_are_unrelated() -> None:
    """Neighbouring seeds do not draw alike."""
    draws = [start_generator(None, seed).integers(0, 2**63) for seed in range(100)]
    assert len(set(draws)) == 100
