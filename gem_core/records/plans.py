"""Plans: the items that episodes start from, fixed before the first episode begins.

All slots of a vector environment draw from one plan. So a data set is covered exactly, a mixture has exact
proportions, a group of episodes shares one start, and a run gives the same episodes whatever the number of slots.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from types import MappingProxyType
from typing import Any

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
        number: Number of earlier items of the same environment in the plan, or in the slot if there is no plan.
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
    """Returns the starts of episodes, one at a time.

    Args:
        plan: Items in order, finite or not; None for an endless queue in which the slots do not share episodes.
        seed: Seed of the run; None draws one.

    Raises:
        ArgumentError: The plan is no iterable, or the seed is not a whole number from 0 up.
    """

    def __init__(self, plan: Iterable[PlanItem] | None, seed: int | None) -> None:
        if plan is not None and (isinstance(plan, str | Mapping) or not isinstance(plan, Iterable)):
            raise ArgumentError(f"a plan is an iterable of PlanItem records, not {type(plan).__name__}")
        self.plan = plan
        self.seed = fresh_seed() if seed is None else checked_seed(seed)
        self._rest = self.starts()
        self._begun = False
        self._counts: Counter[int] = Counter()
        """Episodes drawn so far, by slot, if there is no plan."""

    @property
    def total(self) -> int | None:
        """Number of episodes, also of the ones left out; None if the plan has no length."""
        if isinstance(self.plan, LazyPlan):
            return len(self.plan)
        if not isinstance(self.plan, Collection):
            return None
        return sum(_checked_item(index, item).repeat for index, item in enumerate(self.plan))

    def starts(self) -> Iterator[EpisodeStart]:
        """Yield the starts of all episodes of the plan, from its beginning."""
        counts: Counter[Any] = Counter()
        for index, given in enumerate(() if self.plan is None else self.plan):
            item = _checked_item(index, given)
            # Items of one environment have one id, and the same arguments that are numbers or text.
            small = [(name, value) for name, value in item.kwargs.items() if isinstance(value, str | int | float)]
            environment = item.id, *sorted(small)
            seed = stable_hash(self.seed, "episode", index) if item.seed is None else item.seed
            for repeat in range(item.repeat):
                yield EpisodeStart(item, (index,), repeat, seed, self.seed, counts[environment])
            counts[environment] += 1

    def leave_out(self, is_done: Callable[[EpisodeStart], bool]) -> None:
        """Skip the planned episodes for which a function returns true."""
        self._rest = (start for start in self._rest if not is_done(start))

    def restarted(self, seed: int | None = None) -> EpisodeQueue:
        """Return a queue of the same plan from its beginning, in which nothing is left out.

        Args:
            seed: Another seed for the run; None keeps the present one.

        Raises:
            ArgumentError: The plan is an iterator that has been drawn from, which cannot begin anew.
        """
        if self._begun and isinstance(self.plan, Iterator):
            raise ArgumentError(
                "the plan is an iterator that has been drawn from, so it cannot start over; give a list, "
                "or call reset() without a seed to go on with it"
            )
        return EpisodeQueue(self.plan, self.seed if seed is None else seed)

    def draw(self, slot: int) -> EpisodeStart | None:
        """Return what the next episode of a slot starts from; None when the plan is exhausted."""
        self._begun = True
        if self.plan is not None:
            return next(self._rest, None)
        number = self._counts[slot]
        self._counts[slot] += 1
        seed = stable_hash(self.seed, "episode", slot, number)
        return EpisodeStart(_NO_ITEM, (slot, number), 0, seed, self.seed, number)


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


@dataclass(frozen=True)
class LazyPlan(Iterable[PlanItem], Sized):
    """A plan of known length whose items are made when they are drawn, so that millions take no memory.

    Args:
        count: Number of items, of one episode each.
        items: Returns an iterator over all of them.
    """

    count: int
    items: Callable[[], Iterator[PlanItem]]

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[PlanItem]:
        return self.items()


def interleaved(parts: Collection[LazyPlan]) -> LazyPlan:
    """Return a plan that takes the items of several in turn, until each is exhausted."""
    rows = sum(part.count for part in parts)
    return LazyPlan(rows, lambda: (item for row in zip_longest(*parts) for item in row if item is not None))


def count_plan(
    ids: Iterable[str | None], episodes: int, *, kwargs: Mapping[str, Any] = MappingProxyType({})
) -> LazyPlan:
    """Return a plan of so many episodes for each id, taking the ids in turn.

    Args:
        ids: Environments; None for the slot's own.
        episodes: Number of episodes for each.
        kwargs: Keyword arguments of the environments.
    """
    if episodes < 0:
        raise ArgumentError(f"episodes must be a whole number from 0 up, not {episodes!r}")
    items = [PlanItem(id=env_id, kwargs=dict(kwargs)) for env_id in ids]
    number = episodes * len(items)
    return LazyPlan(number, lambda: (items[place % len(items)] for place in range(number)))


def cover_plan(
    env_id: str | None,
    num_tasks: int,
    *,
    episodes: int | None = None,
    endless: bool = False,
    kwargs: Mapping[str, Any] = MappingProxyType({}),
) -> LazyPlan:
    """Return a plan that takes the rows of a data set in order.

    Args:
        env_id: The environment; None for the slot's own.
        num_tasks: Number of rows.
        episodes: Number of episodes: the first rows, or the rows over again; None for each row once.
        endless: The environment makes fresh rows for every epoch: the index goes on instead of beginning anew.
        kwargs: Keyword arguments of the environment.
    """
    if num_tasks < 1:
        raise ArgumentError(f"there is no row to take: {env_id or 'the environment'} has {num_tasks} tasks")
    number = num_tasks if episodes is None else episodes
    own = dict(kwargs)

    def items() -> Iterator[PlanItem]:
        for place in range(number):
            yield PlanItem(id=env_id, options={"index": place if endless else place % num_tasks}, kwargs=own)

    return LazyPlan(number, items)


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
