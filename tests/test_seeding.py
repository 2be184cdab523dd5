"""Seeds: the stable hash and the streams are pinned, since recorded episodes are replayed from them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.env.seeding import SEED_LIMIT, checked_seed, fresh_seed, generator_at, next_seed, stable_hash
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
        ((np.int64(7), type("Word", (str,), {})("actions")), 3953729934058449),
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


def test_stable_hash_refuses_fractions() -> None:
    """A float has no stable text, so it is not hashed."""
    with pytest.raises(TypeError):
        stable_hash(1.5)  # type: ignore[arg-type]


def test_next_seed_is_pinned_and_goes_through_all_seeds() -> None:
    """The step meets the conditions of Hull and Dobell, so that a stream has 2**53 episodes before it repeats."""
    assert (next_seed(0), next_seed(1)) == (1543160130404687, 6596710130057340)
    increment = next_seed(0)
    multiplier = (next_seed(1) - increment) % SEED_LIMIT
    assert (increment % 2, multiplier % 4) == (1, 1)
    assert next_seed(2**200) < SEED_LIMIT


def test_fresh_seeds_differ() -> None:
    """Fresh seeds come from entropy, and are exact in JSON."""
    seeds = [fresh_seed() for _ in range(50)]
    assert len(set(seeds)) == 50
    assert max(seeds) < SEED_LIMIT


@pytest.mark.parametrize("seed", [-1, True, 1.0, "1", [1], 2**128])
def test_bad_seed_is_refused(seed: Any) -> None:
    """A seed is a whole number from 0 up and below 2**128, and no truth value; NumPy's are taken."""
    assert type(checked_seed(np.uint32(7))) is int
    with pytest.raises(ArgumentError, match="seed"):
        checked_seed(seed)


def test_streams_are_pinned_and_unrelated() -> None:
    """What a seed draws stays the same in every release, and neighbours do not draw alike."""
    generator = generator_at(0)
    assert generator.integers(0, 1000, 5).tolist() == [987, 73, 235, 773, 630]
    assert generator.random() == 0.19846314095360718
    assert len({int(generator_at(seed).integers(0, 2**63)) for seed in range(100)}) == 100
