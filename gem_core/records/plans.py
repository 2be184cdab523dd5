"""Plans: what episodes start from, fixed before the first of them begins.

All slots of a vector environment draw from one plan. So a data set is covered exactly, a mixture has exact
proportions, a group of episodes shares one start, and a run gives the same episodes whatever the number of slots.
"""

from __future__ import annotations

import copy
import math
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, cast, overload

from gem_core.env.seeding import checked_seed, fresh_seed, seed_at, seed_family, stable_hash
from gem_core.errors import ArgumentError


@dataclass(frozen=True)
class PlanItem:
    """What one episode starts from, or a group of them.

    Args:
        id: Id of the environment; None for the slot's own.
        seed: Seed of the episode; None makes it from the run's seed and the item's place in the plan.
        options: Passed to ``reset``, as ``{"index": 3}`` for a row of a data set.
        kwargs: Keyword arguments of the environment, over those of the run.
        group: Name that the episodes of a group share in ``info["group"]``; by default the item's place in the plan
            where ``repeat`` is over 1.
        repeat: Number of episodes that start alike.
    """

    id: str | None = None
    seed: int | None = None
    options: Mapping[str, Any] | None = None
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    group: str | None = None
    repeat: int = 1


_ANY = PlanItem()
"""What an episode without a plan starts from."""


@dataclass(slots=True)
class EpisodeStart:
    """One episode of a plan, as a slot draws it.

    Args:
        item: What it starts from, with the group filled in.
        place: The item's place in the plan; without a plan, the slot and the number of its episode.
        repeat: Which of the item's episodes it is, from 0.
        seed: Seed of the episode, shared by the item's repeats.
        run_seed: Seed of the run.
    """

    item: PlanItem
    place: tuple[int, ...]
    repeat: int
    seed: int
    run_seed: int

    @property
    def key(self) -> str:
        """The item's place in the plan; without a plan, ``"slot.count"``."""
        return ".".join(map(str, self.place))

    @property
    def action_seed(self) -> int:
        """Seed of ``sample_random_action``, different for each repeat."""
        return stable_hash(self.run_seed, "actions", *self.place, self.repeat)


class EpisodeQueue:
    """Hands out draws to slots; safe to call from several threads.

    Args:
        plan: Items in order, finite or not; None for an endless one in which every slot goes on by itself.
        seed: Seed of the run; None draws one.
    """

    def __init__(self, plan: Iterable[PlanItem] | None, seed: int | None) -> None:
        self.seed = fresh_seed() if seed is None else checked_seed(seed)
        self.planned = plan is not None
        self._plan = plan
        self._begun = False
        self._lock = threading.Lock()
        # Where it stands in the plan, as plain values: an interrupt at any place loses nothing but the draw it hits.
        self._rest = None if plan is None or isinstance(plan, Sequence) else enumerate(plan)
        self._next_index = 0
        self._item: tuple[int, PlanItem] | None = None
        self._next_repeat = 0
        self._counts: dict[int, int] = {}
        self._seeds = seed_family(self.seed, "episode")
        self._skipped: Collection[tuple[str, int]] = ()
        self._check: Check | None = None

    @property
    def total(self) -> int | None:
        """Number of episodes of a plan that has a length; None for any other."""
        if not isinstance(self._plan, Collection):
            return None
        if isinstance(self._plan, _Items):
            return len(self._plan)
        return sum(_checked_item(index, item).repeat for index, item in enumerate(self._plan))

    def skip(self, done: Collection[tuple[str, int]], check: Check) -> None:
        """Leave episodes out.

        Args:
            done: Key and repeat of each.
            check: Called with these and what the plan has there, or None; raises what does not fit. Where the plan is
                a sequence it is called for all at once, else for each as it is passed over.
        """
        self._skipped = done
        if not isinstance(self._plan, Sequence):
            self._check = check
            return
        for key, repeat in done:
            draw = None
            if key.isdecimal() and int(key) < len(self._plan):
                item = _checked_item(int(key), self._plan[int(key)])
                draw = self._made(item, int(key), repeat) if 0 <= repeat < item.repeat else None
            check(key, repeat, draw)

    def restarted(self, seed: int | None = None) -> EpisodeQueue:
        """Return the same draws from the beginning.

        Args:
            seed: Another seed for the run; None keeps the present one.

        Raises:
            ArgumentError: The plan is an iterator that has been drawn from, which cannot begin anew.
        """
        if self._begun and isinstance(self._plan, Iterator):
            raise ArgumentError(
                "the plan is an iterator that has been drawn from, so it cannot start over; give a list, "
                "or call reset() without a seed to go on with it"
            )
        return EpisodeQueue(self._plan, self.seed if seed is None else seed)

    def draw(self, slot: int) -> EpisodeStart | None:
        """Return what the next episode of a slot starts from; None when the plan is exhausted."""
        with self._lock:
            self._begun = True
            if self.planned:
                return self._next_of_plan()
            count = self._counts.get(slot, 0)
            self._counts[slot] = count + 1
            return EpisodeStart(_ANY, (slot, count), 0, seed_at(self._seeds, (slot, count)), self.seed)

    def continued(self) -> EpisodeQueue:
        """Return a source that goes on where this one is, and shares no lock with it."""
        other = copy.copy(self)
        other._lock = threading.Lock()
        return other

    def _next_of_plan(self) -> EpisodeStart | None:
        while True:
            if self._item is None:
                found = self._next_item()
                if found is None:
                    return None
                self._next_repeat = 0
                self._item = found[0], _checked_item(*found)
            (index, item), repeat = self._item, self._next_repeat
            if repeat >= item.repeat:
                self._item = None
                continue
            self._next_repeat = repeat + 1
            if not self._skipped or (str(index), repeat) not in self._skipped:
                return self._made(item, index, repeat)
            if self._check is not None:
                self._check(str(index), repeat, self._made(item, index, repeat))

    def _next_item(self) -> tuple[int, PlanItem] | None:
        if self._rest is not None:
            return next(self._rest, None)
        plan, index = cast("Sequence[PlanItem]", self._plan), self._next_index
        if index >= len(plan):
            return None
        self._next_index = index + 1
        return index, plan[index]

    def _made(self, item: PlanItem, index: int, repeat: int) -> EpisodeStart:
        seed = seed_at(self._seeds, (index,)) if item.seed is None else item.seed
        return EpisodeStart(item, (index,), repeat, seed, self.seed)


Check = Callable[[str, int, EpisodeStart | None], None]
"""Takes the key and the repeat of an episode, and what a plan has there; see ``EpisodeQueue.skip``."""


def _checked_item(index: int, item: object) -> PlanItem:
    """Return an item of a plan with its seed checked, and with the name of its group filled in."""
    if not isinstance(item, PlanItem):
        raise ArgumentError(f"a plan yields PlanItem records, and item {index} is {item!r}")
    if type(item.repeat) is not int or item.repeat < 1:
        raise ArgumentError(f"repeat must be a positive whole number, not {item.repeat!r} (plan item {index})")
    if item.seed is not None:
        try:
            item = replace(item, seed=checked_seed(item.seed))
        except ArgumentError as error:
            raise ArgumentError(f"{error} (plan item {index})") from None
    if item.repeat > 1 and item.group is None:
        item = replace(item, group=str(index))
    return item


class _Items(Sequence[PlanItem]):
    """The items of a plan, each made when it is asked for, so that millions take no memory.

    Args:
        count: Number of items, of one episode each.
        item: Makes the item at a place.
    """

    def __init__(self, count: int, item: Callable[[int], PlanItem]) -> None:
        self._count, self._item = count, item

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, place: int) -> PlanItem: ...
    @overload
    def __getitem__(self, place: slice) -> list[PlanItem]: ...
    def __getitem__(self, place: int | slice) -> PlanItem | list[PlanItem]:
        if isinstance(place, slice):
            return [self._item(index) for index in range(*place.indices(self._count))]
        if not -self._count <= place < self._count:
            raise IndexError(f"there are {self._count} items, and none at {place}")
        return self._item(place % self._count)

    def __eq__(self, other: object) -> bool:
        return list(self) == other if isinstance(other, list) else self is other

    __hash__ = None  # type: ignore[assignment]  # it equals a list


def interleaved(parts: Sequence[Sequence[PlanItem]]) -> Sequence[PlanItem]:
    """Return a plan that takes the items of several in turn, until each is exhausted."""
    if len(parts) == 1:
        return parts[0]
    # From each length on at which a part ends, fewer take turns.
    lengths = sorted({len(part) for part in parts})
    starts: list[tuple[int, int, list[Sequence[PlanItem]]]] = []
    begun = row = 0
    for length in lengths:
        present = [part for part in parts if len(part) >= length]
        starts.append((begun, row, present))
        begun += (length - row) * len(present)
        row = length

    def item(place: int) -> PlanItem:
        begun, row, present = next(start for start in reversed(starts) if start[0] <= place)
        rows, part = divmod(place - begun, len(present))
        return present[part][row + rows]

    return _Items(begun, item)


def count_plan(
    ids: Iterable[str | None], episodes: int, *, kwargs: Mapping[str, Any] = MappingProxyType({})
) -> Sequence[PlanItem]:
    """Return a plan of so many episodes for each id, taking the ids in turn.

    Args:
        ids: Environments; None for the slot's own.
        episodes: Number of episodes for each.
        kwargs: Keyword arguments of the environments.
    """
    if episodes < 0:
        raise ArgumentError(f"episodes must be a whole number from 0 up, not {episodes!r}")
    items = [PlanItem(id=env_id, kwargs=dict(kwargs)) for env_id in ids]
    return _Items(episodes * len(items), lambda place: items[place % len(items)])


def cover_plan(
    env_id: str | None,
    num_tasks: int,
    *,
    episodes: int | None = None,
    endless: bool = False,
    kwargs: Mapping[str, Any] = MappingProxyType({}),
) -> Sequence[PlanItem]:
    """Return a plan that takes the rows of a data set in order.

    Args:
        env_id: The environment; None for the slot's own.
        num_tasks: Number of rows.
        episodes: Number of episodes: the first rows, or the rows over again; None for each row once.
        endless: The environment makes fresh rows for every epoch: the index goes on instead of beginning anew.
        kwargs: Keyword arguments of the environment.
    """
    count = num_tasks if episodes is None else episodes
    if num_tasks < 1:
        raise ArgumentError(f"there is no row to take: {env_id or 'the environment'} has {num_tasks} tasks")
    own = dict(kwargs)
    rows = max(count, 1) if endless else num_tasks
    return _Items(count, lambda place: PlanItem(id=env_id, options={"index": place % rows}, kwargs=own))


def mixture_plan(weights: Mapping[str, float], episodes: int) -> list[PlanItem]:
    """Return a plan in which environments have exact proportions, evenly spread.

    After any number of episodes, each environment's count is within one of its share of them.

    Args:
        weights: A positive weight for each id.
        episodes: Number of episodes in all.

    Source: the quota of the Balinski-Young apportionment keeps counts within one of their share.
    """
    total = sum(weights.values())
    if not weights or any(not 0 < weight < math.inf for weight in weights.values()):
        raise ArgumentError(f"a mixture needs positive weights, not {dict(weights)!r}")
    counts = dict.fromkeys(weights, 0)
    plan: list[PlanItem] = []
    for number in range(1, episodes + 1):
        # Among those that stay within their share rounded up, the one whose next episode is due first.
        allowed = [env_id for env_id in weights if counts[env_id] < number * weights[env_id] / total]
        chosen = min(allowed, key=lambda env_id: (counts[env_id] + 1) * total / weights[env_id])
        counts[chosen] += 1
        plan.append(PlanItem(id=chosen))
    return plan


def group_plan(plan: Iterable[PlanItem], size: int) -> Iterator[PlanItem]:
    """Yield each item of a plan as a group of ``size`` episodes that start alike, as GRPO needs them.

    Source: group-relative advantages, arXiv:2402.03300.
    """
    if size < 1:
        raise ArgumentError(f"a group has a positive number of episodes, not {size!r}")
    for item in plan:
        yield replace(item, repeat=size)
