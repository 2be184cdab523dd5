"""``VectorSetup``: what a vector environment is made from; a backend adds where its environments live."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from gem_core.env.wrapper import AnyEnv, concurrency_of
from gem_core.errors import ArgumentError
from gem_core.making.environment import check_choices, make_from
from gem_core.making.layers import Wrappers, wrapper_targets
from gem_core.records.plans import EpisodeQueue, PlanItem
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.types import Concurrency
from gem_core.vector.body import EnvFactory
from gem_core.vector.slot import Autoreset, FaultBudget, OnError, Rules

Entry = tuple[str, Mapping[str, Any]]
"""An id, and keyword arguments."""

IdOrIds = str | Entry | Sequence[str | Entry]
"""One environment, or several."""


@dataclass
class VectorSetup:
    """What a vector environment is made from; see ``make_vec``, which gives it to a backend.

    Args:
        ids: Id of each slot's own environment.
        slot_kwargs: Keyword arguments of each slot's own environment, over ``kwargs``.
        entries: Every id that was asked for with its keyword arguments, once.
        wrappers: Put around each environment.
        kwargs: Keyword arguments for every environment.
        seed: Seed of the run; None draws one.
        plan: What episodes start from.
        autoreset: ``"same_step"``, ``"next_step"`` or ``"disabled"``.
        step_timeout: Seconds that a step or a reset may take; None for as long as it likes.
        on_error: ``"truncate"`` or ``"raise"``.
    """

    ids: list[str]
    slot_kwargs: list[Mapping[str, Any]]
    entries: list[Entry]
    wrappers: Wrappers = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    plan: Iterable[PlanItem] | None = None
    autoreset: Autoreset = "same_step"
    step_timeout: float | None = None
    on_error: OnError = "truncate"
    _kinds: dict[str, Concurrency] = field(default_factory=dict)

    def __post_init__(self) -> None:
        limit = self.step_timeout
        if limit is not None and not (isinstance(limit, int | float) and 0 < limit < float("inf")):
            raise ArgumentError(f"step_timeout must be a positive number of seconds, not {limit!r}")

    @classmethod
    def of(cls, ids: IdOrIds, num_envs: int | None, **options: Any) -> VectorSetup:
        """Return the setup for what was asked for: the slots take the ids in turn; see ``make_vec``.

        Raises:
            ArgumentError: There is no id, or one has not the form ``id`` or ``(id, {keyword: value})``; or there is no
                such keyword, or option of a wrapper.
            UnknownEnvError: There is no such environment.
        """
        if not isinstance(ids, Iterable):
            raise ArgumentError(
                f"environments are an id, (id, {{keyword: value}}) or a list of these, not {ids!r:.200}"
            )
        given = [ids] if isinstance(ids, str) or _is_pair(ids) else list(ids)
        entries = [_entry(one) for one in given]
        if not entries:
            raise ArgumentError("make_vec needs at least one environment id")
        count = len(entries) if num_envs is None else num_envs
        if not isinstance(count, int) or count < 1:
            raise ArgumentError(f"num_envs must be a positive whole number, not {count!r}")
        own = [entries[slot % len(entries)] for slot in range(count)]
        distinct = [entry for place, entry in enumerate(entries) if entry not in entries[:place]]
        setup = cls([env_id for env_id, _ in own], [kwargs for _, kwargs in own], distinct, **options)
        for env_id, kwargs in distinct:
            record = registry().env(env_id)
            check_choices(record, {**setup.kwargs, **kwargs}, setup.wrappers)
        return setup

    @property
    def all_ids(self) -> list[str]:
        """Every id that was asked for, once."""
        return list(dict.fromkeys(env_id for env_id, _ in self.entries))

    def rules(self) -> Rules:
        """Return what all slots share."""
        budget = FaultBudget(limit=max(16, 2 * len(self.ids)))
        return Rules(new_source(self.plan, self.seed), budget, self.autoreset, self.on_error)

    def make(self, env_id: str, overrides: Mapping[str, Any]) -> AnyEnv:
        """Make an environment, with some keyword arguments changed."""
        return make_from(registry().env(env_id), {**self.kwargs, **overrides}, self.wrappers)

    def factories(self) -> list[EnvFactory]:
        """Return what makes the environment of each slot in this process."""
        made: dict[str, EnvFactory] = {own_id: partial(self._make_own, own_id) for own_id in set(self.ids)}
        return [made[own_id] for own_id in self.ids]

    def _make_own(self, own_id: str, env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
        return self.make(env_id or own_id, overrides)

    def task_kind(self, env_id: str | None) -> Concurrency | None:
        """Return what a task needs by its class, without its wrappers; None where that is not known by class."""
        if env_id is None:
            return None
        if env_id not in self._kinds:
            record = registry().env(env_id)
            entry_point = load_entry_point(record.entry_point, f"environment {env_id!r}")
            kind = getattr(entry_point, "concurrency", None)
            if not isinstance(kind, str):
                return None
            self._kinds[env_id] = kind  # type: ignore[assignment]  # checked where it is used
        return self._kinds[env_id]

    def wrappers_compute(self) -> bool:
        """Tell whether a wrapper or tool, by its class, needs a process to itself as ``"process"`` tasks do."""
        for maker in wrapper_targets(self.wrappers):
            target: Any = maker
            if isinstance(maker, str):
                entry_point = maker if ":" in maker else registry().wrapper(maker).entry_point
                target = load_entry_point(entry_point, f"wrapper {maker!r}")
            if "process" in (getattr(target, "needs", None), getattr(target, "concurrency", None)):
                return True
        return False

    def stack_kind(self, env_id: str) -> Concurrency:
        """Return what an environment needs together with its wrappers; one may be made and closed to find it out."""
        kind = self.task_kind(env_id)
        if kind is not None and (kind == "process" or not self.wrappers):
            return kind
        env = self.make(env_id, {})
        try:
            return concurrency_of(env)
        finally:
            env.close()


def backend_and_options(backend: object) -> tuple[str, Mapping[str, Any]]:
    """Return the name of a backend and its options.

    Raises:
        ArgumentError: It has not the form ``name`` or ``(name, {option: value})``.
    """
    if isinstance(backend, str):
        return backend, {}
    if isinstance(backend, Sequence) and len(backend) == 2:
        name, options = backend
        if isinstance(name, str) and isinstance(options, Mapping):
            return name, options
    raise ArgumentError(f"a backend is a name, or (name, {{option: value}}), not {backend!r:.200}")


def new_source(plan: Iterable[PlanItem] | None, seed: int | None) -> EpisodeQueue:
    """Return the draws of a run."""
    if plan is not None and (isinstance(plan, str | Mapping) or not isinstance(plan, Iterable)):
        raise ArgumentError(f"a plan is an iterable of PlanItem records, not {type(plan).__name__}")
    return EpisodeQueue(plan, seed)


def _is_pair(given: object) -> bool:
    return isinstance(given, tuple) and len(given) == 2 and isinstance(given[1], Mapping)


def _entry(given: object) -> Entry:
    if isinstance(given, str):
        return given, {}
    if isinstance(given, tuple) and _is_pair(given):
        return given[0], dict(given[1])
    raise ArgumentError(f"an environment is an id, or (id, {{keyword: value}}), not {given!r:.200}")
