"""Plans: the items that episodes start from, fixed before the first episode begins.

All slots of a vector environment draw from one plan. So a data set is covered exactly, a mixture has exact
proportions, a group of episodes shares one start, and a run gives the same episodes whatever the number of slots.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, cast

from gem_core.env.seeding import checked_seed, fresh_seed, stable_hash
from gem_core.errors import ArgumentError


@dataclass(frozen=True)
class PlanItem:
    """The start of one episode, or of a group of episodes.

    Args:
        id: Id of the environment; None for the slot's own.
        seed: Seed of the episode; None makes it from the run's seed and the item's place in the plan.
        options: Passed to ``reset``, as ``{"index": 3}`` for a row of a data set.
        kwargs: Keyword arguments of the environment, which override the run's. Wrappers in ``wrappers`` go around the
            wrappers of the run.
        group: Name that the episodes of a group share in ``info["group"]``; by default the item's place in the plan,
            if ``repeat`` is over 1.
        repeat: Number of episodes that start alike.
        rotation: If several agents act, the number of seats by which they move on. With None, agents given by seat
            stay, and agents given as a list move on by one from item to item of the same environment.
        agent: Name of the agent, if ``rollout`` is given several by name, each for episodes of its own.
    """

    id: str | None = None
    seed: int | None = None
    options: Mapping[str, Any] | None = None
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    group: str | None = None
    repeat: int = 1
    rotation: int | None = None
    agent: str | None = None


_NO_ITEM = PlanItem()
"""Takes the place of the item if there is no plan."""


@dataclass(slots=True)
class EpisodeStart:
    """One episode of a plan, as a slot draws it.

    Args:
        item: The item of the plan, with the group filled in.
        place: The item's place in the plan; without a plan, the slot and the number of its episode.
        repeat: Which of the item's episodes it is, from 0.
        seed: Seed of the episode, shared by the item's repeats.
        run_seed: Seed of the run.
        number: Number of earlier items of the same environment in the plan, or in the slot if there is no plan; 0 for
            an episode that was looked up.
    """

    item: PlanItem
    place: tuple[int, ...]
    repeat: int
    seed: int
    run_seed: int
    number: int = field(default=0, compare=False)

    @property
    def key(self) -> str:
        """The item's place in the plan; without a plan, ``"slot.count"``."""
        return ".".join(map(str, self.place))

    @property
    def action_seed(self) -> int:
        """Seed of ``sample_random_action``, different for each repeat."""
        return stable_hash(self.run_seed, "actions", *self.place, self.repeat)


class EpisodeQueue:
    """Returns the starts of episodes, one at a time; slots may draw from several threads.

    Args:
        plan: Items in order, finite or not; None for an endless queue in which the slots do not share episodes.
        seed: Seed of the run; None draws one.

    Raises:
        ArgumentError: The plan is no iterable, or the seed is not a whole number from 0 up.
    """

    def __init__(self, plan: Iterable[PlanItem] | None, seed: int | None) -> None:
        if plan is not None and (isinstance(plan, str | Mapping) or not isinstance(plan, Iterable)):
            raise ArgumentError(f"a plan is an iterable of PlanItem records, not {type(plan).__name__}")
        self.seed = fresh_seed() if seed is None else checked_seed(seed)
        self.planned = plan is not None
        self._plan = plan
        self._is_done: Callable[[EpisodeStart], bool] = lambda start: False
        self._lock = threading.Lock()
        self._begun = False
        self._rest = self._starts(plan or ())
        self._counts: Counter[Any] = Counter()
        """Items drawn so far, by environment; without a plan by slot."""

    @property
    def total(self) -> int | None:
        """Number of episodes, also of the ones left out; None if the plan has no length."""
        if isinstance(self._plan, LazyPlan):
            return len(self._plan)
        if not isinstance(self._plan, Collection):
            return None
        return sum(_checked_item(index, item).repeat for index, item in enumerate(self._plan))

    @property
    def searchable(self) -> bool:
        """Whether ``find`` can look up any episode, because the plan is a sequence."""
        return isinstance(self._plan, Sequence)

    def find(self, key: str, repeat: int) -> EpisodeStart | None:
        """Return the start of an episode of a searchable plan; None if the plan has no such episode."""
        plan = cast("Sequence[PlanItem]", self._plan)
        if not key.isdecimal() or int(key) >= len(plan):
            return None
        item = _checked_item(int(key), plan[int(key)])
        return self._start(int(key), item, repeat) if 0 <= repeat < item.repeat else None

    def leave_out(self, is_done: Callable[[EpisodeStart], bool]) -> None:
        """Skip the planned episodes for which a function returns true."""
        self._is_done = is_done

    def restarted(self, seed: int | None = None) -> EpisodeQueue:
        """Return a queue of the same plan from its beginning, in which nothing is left out.

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
                return next((start for start in self._rest if not self._is_done(start)), None)
            count = self._counts[slot]
            self._counts[slot] += 1
            seed = stable_hash(self.seed, "episode", slot, count)
            return EpisodeStart(_NO_ITEM, (slot, count), 0, seed, self.seed, count)

    def _starts(self, plan: Iterable[PlanItem]) -> Iterator[EpisodeStart]:
        for index, given in enumerate(plan):
            item = _checked_item(index, given)
            environment = _environment(item)
            number = self._counts[environment]
            self._counts[environment] += 1
            for repeat in range(item.repeat):
                yield self._start(index, item, repeat, number)

    def _start(self, index: int, item: PlanItem, repeat: int, number: int = 0) -> EpisodeStart:
        seed = stable_hash(self.seed, "episode", index) if item.seed is None else item.seed
        return EpisodeStart(item, (index,), repeat, seed, self.seed, number)


def _environment(item: PlanItem) -> Any:
    """Return a key that items of one environment share: its id, and those arguments that are numbers or text."""
    arguments = sorted(item.kwargs.items(), key=lambda each: each[0]) if item.kwargs else ()
    return item.id, tuple((name, value) for name, value in arguments if isinstance(value, str | int | float))


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


class LazyPlan(Sequence[PlanItem]):
    """A plan whose items, of one episode each, are made when they are asked for, so that millions take no memory.

    Args:
        count: Number of items.
        item: Makes the item at a place.
    """

    def __init__(self, count: int, item: Callable[[int], PlanItem]) -> None:
        self._places, self._item = range(count), item

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, place: Any) -> Any:
        chosen = self._places[place]
        return [self._item(each) for each in chosen] if isinstance(chosen, range) else self._item(chosen)


def interleaved(parts: Sequence[Sequence[PlanItem]]) -> Sequence[PlanItem]:
    """Return a plan that takes the items of several in turn, until each is exhausted."""
    if len(parts) == 1:
        return parts[0]
    stretches: list[tuple[int, int, list[Sequence[PlanItem]]]] = []
    """Where one begins, the row of its first items, and the parts that have it."""
    first = row = 0
    for end in sorted(set(map(len, parts))):
        present = [part for part in parts if len(part) > row]
        stretches.append((first, row, present))
        first, row = first + (end - row) * len(present), end

    def item(place: int) -> PlanItem:
        first, row, present = next(each for each in reversed(stretches) if each[0] <= place)
        rows, part = divmod(place - first, len(present))
        return present[part][row + rows]

    return LazyPlan(first, item)


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
    return LazyPlan(episodes * len(items), lambda place: items[place % len(items)])


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
    return LazyPlan(count, lambda place: PlanItem(id=env_id, options={"index": place % rows}, kwargs=own))


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
