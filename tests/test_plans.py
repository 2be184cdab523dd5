"""Plans: exact coverage, exact proportions, groups, and seeds."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from itertools import zip_longest
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.env.seeding import SEED_LIMIT
from gem_core.errors import ArgumentError
from gem_core.records.plans import (
    EpisodeQueue,
    EpisodeStart,
    PlanItem,
    count_plan,
    cover_plan,
    group_plan,
    interleaved,
    mixture_plan,
)


def drawn(queue: EpisodeQueue, slots: int = 1) -> list[EpisodeStart]:
    draws: list[EpisodeStart] = []
    while (draw := queue.draw(len(draws) % slots)) is not None:
        draws.append(draw)
    return draws


def test_repeats_share_seed_and_group_and_differ_in_action_seed() -> None:
    """A group starts alike, and its members act apart."""
    draws = drawn(EpisodeQueue(group_plan([PlanItem(), PlanItem()], 3), 0))
    assert [draw.key for draw in draws] == ["0", "0", "0", "1", "1", "1"]
    assert [draw.repeat for draw in draws] == [0, 1, 2, 0, 1, 2]
    assert [len({draw.seed for draw in draws[i : i + 3]}) for i in (0, 3)] == [1, 1]
    assert draws[0].seed != draws[3].seed
    assert len({draw.action_seed for draw in draws}) == 6
    assert [draw.item.group for draw in draws] == ["0"] * 3 + ["1"] * 3


def test_without_a_plan_every_slot_goes_on_for_ever_by_itself() -> None:
    """The key is (slot, count), whatever the other slots do."""
    first, second = EpisodeQueue(None, 1), EpisodeQueue(None, 1)
    alone = [first.draw(2) for _ in range(5)]
    among = []
    for _ in range(5):
        second.draw(0)
        among.append(second.draw(2))
        second.draw(1)
    assert alone == among
    assert len({draw.seed for draw in alone if draw}) == 5


def test_seeds_are_exact_in_json_readers_that_use_doubles() -> None:
    """All lie below 2**53."""
    starts = drawn(EpisodeQueue([PlanItem()], 2))
    assert all(start.seed < SEED_LIMIT and start.action_seed < SEED_LIMIT for start in starts)


def test_cover_plan_goes_on_where_every_epoch_has_fresh_rows() -> None:
    """The environment finds the epoch from the index."""
    plan = cover_plan("a:A", 3, episodes=5, endless=True)
    assert [item.options["index"] for item in plan if item.options] == [0, 1, 2, 3, 4]
    assert not list(cover_plan("a:A", 3, episodes=0, endless=True))


@given(
    weights=st.dictionaries(st.sampled_from(["a:A", "b:B", "c:C", "d:D"]), st.integers(1, 100), min_size=1),
    episodes=st.integers(0, 60),
)
def test_mixture_keeps_within_one_of_every_share(weights: dict[str, int], episodes: int) -> None:
    """At every point of the plan, not only at its end."""
    total = sum(weights.values())
    counts: Counter[str] = Counter()
    for number, item in enumerate(mixture_plan({**weights}, episodes), start=1):
        counts[str(item.id)] += 1
        for env_id, weight in weights.items():
            assert abs(counts[env_id] - number * weight / total) < 1
    assert counts.total() == episodes


@pytest.mark.parametrize(
    "weights", [{}, {"a:A": 0.0}, {"a:A": -1.0}, {"a:A": float("nan")}, {"a:A": float("inf"), "b:B": 1.0}]
)
def test_mixture_refuses_weights_that_mean_nothing(weights: dict[str, float]) -> None:
    """The error shows them."""
    with pytest.raises(ArgumentError, match="a mixture needs positive weights"):
        mixture_plan(weights, 3)


def test_counts_and_group_sizes_must_make_sense() -> None:
    """Negative numbers are refused."""
    with pytest.raises(ArgumentError):
        count_plan(["a:A"], -1)
    with pytest.raises(ArgumentError):
        list(group_plan([], 0))


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (PlanItem(seed=-1), r"seed.*-1.*item 1"),
        (PlanItem(seed="1"), r"seed.*'1'.*item 1"),  # type: ignore[arg-type]
        (PlanItem(repeat=1.5), r"repeat.*1\.5.*item 1"),  # type: ignore[arg-type]
        (PlanItem(repeat=0), r"repeat.*0.*item 1"),
        ("a:A", "item 1.*'a:A'"),
    ],
)
def test_items_that_cannot_be_right_are_refused(item: Any, message: str) -> None:
    """They are the plan's mistake, not a fault of an environment; the error names the item."""
    with pytest.raises(ArgumentError, match=message):
        drawn(EpisodeQueue([PlanItem(), item], 0))


@pytest.mark.parametrize("seed", [-1, 1.5, "abc"])
def test_seed_of_a_run_is_a_whole_number(seed: Any) -> None:
    """Whatever else is refused before the first episode."""
    with pytest.raises(ArgumentError, match="seed must be a whole number from 0 up"):
        EpisodeQueue(None, seed)


def test_seeds_of_numpy_become_plain() -> None:
    """They stand in ``info`` and in files, which are plain JSON."""
    source = EpisodeQueue([PlanItem(seed=np.int64(4))], np.int64(3))  # type: ignore[arg-type]  # that is the point
    draw = source.draw(0)
    assert draw is not None
    assert (type(draw.seed), draw.seed, type(source.seed)) == (int, 4, int)


def test_data_set_without_rows_cannot_be_covered() -> None:
    """The error says so, with a number of episodes and without."""
    for episodes in (None, 3):
        with pytest.raises(ArgumentError, match="there is no row to take: math:Empty has 0 tasks"):
            cover_plan("math:Empty", 0, episodes=episodes)


def in_turn(parts: list[list[PlanItem]]) -> list[PlanItem]:
    """Return what ``interleaved`` does, as one would write it down with lists."""
    return [item for row in zip_longest(*parts) for item in row if item is not None]


@given(lengths=st.lists(st.integers(0, 7), max_size=6), data=st.data())
def test_interleaved_plans_are_those_of_a_list(lengths: list[int], data: st.DataObject) -> None:
    """As a whole, at every place, from behind, and in every slice."""
    parts = [[PlanItem(id=f"a:P{part}", seed=place) for place in range(length)] for part, length in enumerate(lengths)]
    expected, plan = in_turn(parts), interleaved(parts)
    assert len(plan) == len(expected)
    assert list(plan) == list(iter(plan)) == expected
    assert [plan[place - len(plan)] for place in range(len(plan))] == expected
    assert list(reversed(plan)) == expected[::-1]
    chosen = data.draw(st.slices(len(expected)))
    assert plan[chosen] == expected[chosen]
    for place in (len(plan), -len(plan) - 1):
        with pytest.raises(IndexError):
            plan[place]


@given(rows=st.integers(1, 9), episodes=st.none() | st.integers(0, 30))
def test_cover_plans_are_those_of_a_list(rows: int, episodes: int | None) -> None:
    """The rows in order, and over again."""
    count = rows if episodes is None else episodes
    expected = [PlanItem(id="a:A", options={"index": place % rows}) for place in range(count)]
    assert list(cover_plan("a:A", rows, episodes=episodes)) == expected


def test_three_million_items_take_no_memory() -> None:
    """Each is made when it is drawn, and nothing is kept of it."""
    tracemalloc.start()
    try:
        plan = interleaved([cover_plan("a:A", 1_000_000), count_plan(["b:B"], 1_999_000), cover_plan("c:C", 1_000)])
        source = EpisodeQueue(plan, 0)
        assert source.total == len(plan) == 3_000_000
        for _ in range(1000):
            source.draw(0)
        assert plan[2_999_999] == PlanItem(id="b:B")
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert taken < 100_000


def test_number_of_episodes_counts_repeats_and_refuses_what_is_no_item() -> None:
    """Of a list; an iterator does not tell."""
    assert EpisodeQueue([PlanItem(repeat=3), PlanItem()], 0).total == 4
    assert EpisodeQueue(iter([PlanItem()]), 0).total is None
    with pytest.raises(ArgumentError, match="item 1 is 'a:A'"):
        _ = EpisodeQueue([PlanItem(), "a:A"], 0).total  # type: ignore[list-item]  # that is the point


def test_an_episode_of_a_sequence_can_be_looked_up() -> None:
    """By key and repeat, as it would be drawn; what the plan does not have is None."""
    items = [PlanItem(), PlanItem(seed=11, repeat=2)]
    queue = EpisodeQueue(items, 3)
    assert queue.searchable
    assert [queue.find(start.key, start.repeat) for start in drawn(EpisodeQueue(items, 3))] == drawn(queue)
    assert [queue.find(*place) for place in (("0", 1), ("1", -1), ("2", 0), ("0.1", 0), ("x", 0))] == [None] * 5
    assert not EpisodeQueue(iter(items), 3).searchable


ITEMS = st.builds(
    PlanItem,
    id=st.none() | st.sampled_from(["a:A", "b:B"]),
    seed=st.none() | st.integers(0, 2**60),
    options=st.none() | st.fixed_dictionaries({"index": st.integers(0, 9)}),
    group=st.none() | st.sampled_from(["g", "h"]),
    repeat=st.integers(1, 4),
)


@given(items=st.lists(ITEMS, max_size=8), seed=st.integers(0, 2**53), sequence=st.booleans(), data=st.data())
def test_a_plan_gives_the_same_episodes_in_the_same_order_to_whatever_slots_draw(
    items: list[PlanItem], seed: int, sequence: bool, data: st.DataObject
) -> None:
    """Any slots in any order, of a list or an iterator, started over, and with some episodes left out."""
    expected = drawn(EpisodeQueue(items, seed))
    places = [(start.key, start.repeat) for start in expected]
    assert places == [(str(place), repeat) for place, item in enumerate(items) for repeat in range(item.repeat)]
    done = set(data.draw(st.lists(st.sampled_from(places), unique=True))) if places else set()
    queue = EpisodeQueue(items if sequence else iter(items), seed)
    if sequence and data.draw(st.booleans()):
        drawn(queue)
        queue = queue.restarted()
    queue.leave_out(lambda start: (start.key, start.repeat) in done)
    starts = []
    while (start := queue.draw(data.draw(st.integers(0, 3)))) is not None:
        starts.append(start)
    assert starts == [start for start in expected if (start.key, start.repeat) not in done]
    assert queue.draw(0) is None
