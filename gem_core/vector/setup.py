"""``VectorSetup``: the arguments of a vector environment, checked, from which a backend builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

from gem_core.arguments import parse_choice
from gem_core.env.wrapper import AnyEnv, concurrency_of, most_demanding
from gem_core.errors import ArgumentError
from gem_core.making.environment import make_from
from gem_core.making.layers import Wrappers, wrapper_targets
from gem_core.records.plans import PlanItem
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EnvSpec
from gem_core.types import Concurrency

Autoreset = Literal["same_step", "next_step", "disabled"]
"""When the next episode begins after one has ended; see ``make_vec``."""

OnError = Literal["truncate", "raise"]

Backend = str | tuple[str, Mapping[str, Any]]
"""Name of a backend, with options as in ``"process:workers=2"``; or the name, and the options."""

IdWithKwargs = tuple[str, Mapping[str, Any]]
"""An id, and keyword arguments."""

IdOrIds = str | IdWithKwargs | Sequence[str | IdWithKwargs]
"""One environment or several, each with or without keyword arguments."""


@dataclass
class VectorSetup:
    """The arguments of a vector environment; ``make_vec`` passes them to a backend.

    Args:
        slots: Id of each slot's own environment, None for one without an id, and its keyword arguments, which override
            ``kwargs``.
        entries: The requested ids with their keyword arguments, each once.
        wrappers: Wrappers of each environment.
        kwargs: Keyword arguments for every environment.
        seed: Seed of the run; None draws one.
        plan: Items that episodes start from.
        autoreset: ``"same_step"``, ``"next_step"`` or ``"disabled"``.
        step_timeout: Seconds that a step or a reset may take; None for no limit.
        on_error: ``"truncate"`` or ``"raise"``.
        max_faults: Faults in a row that do not stop the run; None for 16, or twice the number of slots.
        factory: Makes environments, instead of the registry.
        records: Records of the requested ids, which a worker receives.
    """

    slots: list[tuple[str | None, Mapping[str, Any]]]
    entries: list[tuple[str | None, Mapping[str, Any]]]
    wrappers: Wrappers = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    plan: Iterable[PlanItem] | None = None
    autoreset: Autoreset = "same_step"
    step_timeout: float | None = None
    on_error: OnError = "truncate"
    max_faults: int | None = None
    factory: Callable[[str | None, Mapping[str, Any]], AnyEnv] | None = None
    records: dict[str, EnvSpec] = field(default_factory=dict)

    def __post_init__(self) -> None:
        limit = self.step_timeout
        if limit is not None and not (isinstance(limit, int | float) and 0 < limit < float("inf")):
            raise ArgumentError(f"step_timeout must be a positive number of seconds, not {limit!r}")
        if self.on_error not in get_args(OnError):
            raise ArgumentError(f"on_error must be 'truncate' or 'raise', not {self.on_error!r}")
        if self.autoreset not in get_args(Autoreset):
            raise ArgumentError(f"autoreset must be 'same_step', 'next_step' or 'disabled', not {self.autoreset!r}")

    @classmethod
    def of(cls, ids: IdOrIds, num_envs: int | None, **options: Any) -> VectorSetup:
        """Return the setup for ids, which are assigned to the slots in turn; see ``make_vec``.

        Raises:
            ArgumentError: There is no id, or one is neither ``id`` nor ``(id, {keyword: value})``.
            UnknownEnvError: There is no such environment.
        """
        if not isinstance(ids, Iterable):
            raise ArgumentError(
                f"environments are an id, (id, {{keyword: value}}) or a list of these, not {ids!r:.200}"
            )
        given = [ids] if isinstance(ids, str) or _is_pair(ids) else list(ids)
        rule = "an environment is an id, or (id, {keyword: value})"
        entries = [(one, {}) if isinstance(one, str) else parse_choice(one, rule, _is_id) for one in given]
        if not entries:
            raise ArgumentError("make_vec needs at least one environment id")
        count = len(entries) if num_envs is None else num_envs
        if not isinstance(count, int) or count < 1:
            raise ArgumentError(f"num_envs must be a positive whole number, not {count!r}")
        setup = cls([entries[slot % len(entries)] for slot in range(count)], [], **options)
        for env_id, kwargs in entries:
            if (env_id, kwargs) not in setup.entries:
                setup.entries.append((env_id, kwargs))
                setup.records[env_id] = registry().env(env_id)
        return setup

    def arguments(self, overrides: Mapping[str, Any]) -> tuple[dict[str, Any], Wrappers, Wrappers]:
        """Return the arguments of an environment, the wrappers of all, and those that are named among its arguments."""
        arguments = {**self.kwargs, **overrides}
        return arguments, self.wrappers, arguments.pop("wrappers", ())

    def make(self, env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
        """Make an environment, with some keyword arguments changed."""
        if self.factory is not None:
            return self.factory(env_id, overrides)
        return make_from(self.record(env_id), *self.arguments(overrides))

    def record(self, env_id: str | None) -> EnvSpec:
        """Return the record of an environment.

        Raises:
            UnknownEnvError: There is none.
        """
        return self.records.get(env_id or "") or registry().env(env_id or "")

    def task_concurrency(self, env_id: str | None) -> Concurrency | None:
        """Return the concurrency that a task's class declares, without wrappers; None if it does not."""
        if self.factory is not None:
            return None
        task = load_entry_point(self.record(env_id).entry_point, f"environment {env_id!r}")
        declared = getattr(task, "concurrency", None)  # a function has none
        return cast("Concurrency", declared) if isinstance(declared, str) else None

    def concurrency(self, env_id: str | None) -> Concurrency | None:
        """Return what an environment and its wrappers declare; None if it does not, and is no requested id.

        If the task's class does not declare it, an environment is made with the arguments that come with its id.
        """
        declared = self.task_concurrency(env_id)
        requested = [kwargs for each, kwargs in self.entries if each == env_id]
        if declared is None and requested:
            env = self.make(env_id, requested[0])
            try:
                declared = concurrency_of(env)
            finally:
                env.close()
        stacks = [self.wrappers, self.kwargs.get("wrappers", ())]
        stacks += [kwargs.get("wrappers", ()) for kwargs in requested]
        for wrappers in stacks:
            if wrappers and declared is not None:
                declared = most_demanding(declared, *_declared_by(wrappers))
        return declared


def _declared_by(wrappers: Wrappers) -> list[Concurrency]:
    """Return what wrapper classes declare as ``needs`` and tools as ``concurrency``, without making any."""
    declared = []
    for target in wrapper_targets(wrappers):
        made: Any = target
        if isinstance(target, str):
            entry_point = target if ":" in target else registry().wrapper(target).entry_point
            made = load_entry_point(entry_point, f"wrapper {target!r}")
        declared += [
            each for each in (getattr(made, "needs", None), getattr(made, "concurrency", None)) if isinstance(each, str)
        ]
    return cast("list[Concurrency]", declared)


def _is_pair(given: object) -> bool:
    return isinstance(given, tuple) and len(given) == 2 and isinstance(given[1], Mapping)


def _is_id(given: object) -> bool:
    return isinstance(given, str)
