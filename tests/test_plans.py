"""Plans: exact coverage, exact proportions, groups, and seeds."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

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


@given(lengths=st.lists(st.integers(0, 7), max_size=6))
def test_interleaved_plans_take_an_item_of_each_in_turn(lengths: list[int]) -> None:
    """Until each is exhausted; the plan can be gone through again."""
    parts = [count_plan([f"a:P{part}"], length) for part, length in enumerate(lengths)]
    plan = interleaved(parts)
    expected = [f"a:P{part}" for row in range(8) for part, length in enumerate(lengths) if row < length]
    assert [item.id for item in plan] == [item.id for item in plan] == expected
    assert len(plan) == EpisodeQueue(plan, 0).total == len(expected)


@pytest.mark.parametrize(
    ("episodes", "endless", "rows"),
    [(None, False, [0, 1, 2]), (5, False, [0, 1, 2, 0, 1]), (5, True, [0, 1, 2, 3, 4]), (0, True, [])],
)
def test_cover_plans_take_the_rows_in_order(episodes: int | None, endless: bool, rows: list[int]) -> None:
    """And over again, or fresh ones for every epoch."""
    plan = cover_plan("a:A", 3, episodes=episodes, endless=endless)
    assert [item.options["index"] for item in plan if item.options] == rows
    assert len(plan) == EpisodeQueue(list(plan), 0).total == len(rows)


def test_items_are_made_when_they_are_drawn() -> None:
    """So that a plan of millions takes no memory, and one without an end can be drawn from."""
    queue = EpisodeQueue(interleaved([cover_plan("a:A", 1_000, episodes=sys.maxsize), count_plan(["b:B"], 2)]), 0)
    starts = [queue.draw(0) for _ in range(6)]
    assert [start.item.id for start in starts if start] == ["a:A", "b:B"] * 2 + ["a:A"] * 2
    assert [start.number for start in starts if start] == [0, 0, 1, 1, 2, 3]


@pytest.mark.parametrize(
    ("plan", "value"),
    [
        (lambda: mixture_plan({}, 3), "{}"),
        (lambda: mixture_plan({"a:A": float("inf"), "b:B": 0.0}, 3), "inf"),
        (lambda: mixture_plan({"a:A": float("nan")}, 3), "nan"),
        (lambda: count_plan(["a:A"], -1), "-1"),
        (lambda: list(group_plan([], 0)), "0"),
        (lambda: cover_plan("math:Empty", 0, episodes=3), "math:Empty"),
        (lambda: EpisodeQueue(None, "abc"), "'abc'"),  # type: ignore[arg-type]  # that is the point
        (lambda: EpisodeQueue("abc", 0), "str"),  # type: ignore[arg-type]
    ],
)
def test_plans_that_mean_nothing_are_refused(plan: Callable[[], object], value: str) -> None:
    """The error shows the value."""
    with pytest.raises(ArgumentError) as caught:
        plan()
    assert value in str(caught.value)


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
