"""``CheapRandom``: the same numbers for a seed everywhere, over the whole range."""

from __future__ import annotations

import pytest

from gem_games.cheap_random import CheapRandom


def test_numbers_of_a_seed_are_pinned() -> None:
    """What a seed draws stays the same in every release: it fixes the boards of the games."""
    draws = CheapRandom(8)
    assert [draws.below(100) for _ in range(6)] == [61, 1, 18, 87, 99, 45]


def test_numbers_repeat_and_cover_their_range() -> None:
    """The same seed gives the same numbers, over many blocks of the hash, and every value of the range turns up."""
    draws, again = CheapRandom(8), CheapRandom(8)
    numbers = [draws.below(6) for _ in range(1_000)]
    assert numbers == [again.below(6) for _ in range(1_000)]
    assert sorted(set(numbers)) == [0, 1, 2, 3, 4, 5]
    assert min(numbers.count(face) for face in range(6)) > 120
    assert numbers != [CheapRandom(9).below(6) for _ in range(1_000)]


@pytest.mark.parametrize("limit", [1, 2, 2**53, 2**256])
def test_numbers_stay_below_their_limit(limit: int) -> None:
    assert all(0 <= CheapRandom(seed).below(limit) < limit for seed in range(100))
