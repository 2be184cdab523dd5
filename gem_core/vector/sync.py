"""The backend ``sync``: steps one environment after another, in the calling thread."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.making import MadeSpec, Wrappers, make_from
from gem_core.plans import Draw, DrawSource, PlanItem
from gem_core.registry import registry
from gem_core.types import Info, Observation
from gem_core.vector.base import Actions, VectorEnv, VectorStep, new_source
from gem_core.vector.slot import EnvFactory, FaultBudget, Slot
from gem_core.wrapper import AnyEnv


class SyncVectorEnv(VectorEnv):
    """Steps one environment after another, in the calling thread.

    It contains exceptions of an environment, and nothing worse: a hang holds up the batch.

    Args:
        ids: Ids that the slots take in turn.
        num_envs: Number of slots.
        wrappers: Put around each; see ``make``.
        seed: Seed of the run; None draws one.
        plan: What episodes start from.
        on_error: ``"truncate"`` or ``"raise"``.
        env_kwargs: Keyword arguments for every environment.
    """

    def __init__(
        self,
        ids: Sequence[str],
        num_envs: int,
        *,
        wrappers: Wrappers = (),
        seed: int | None = None,
        plan: Iterable[PlanItem] | None = None,
        on_error: str = "truncate",
        env_kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        kwargs = dict(env_kwargs or {})

        def factory_of(own_id: str) -> EnvFactory:
            def factory(env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
                record = registry().env(env_id or own_id)
                return make_from(record, {**kwargs, **overrides}, wrappers, registry().wrapper)

            return factory

        slot_ids = [ids[slot % len(ids)] for slot in range(num_envs)]
        self._set_up(list(slot_ids), [factory_of(env_id) for env_id in slot_ids], new_source(plan, seed), on_error)
        self.all_ids = list(dict.fromkeys(ids))

    @classmethod
    def around(
        cls, env: AnyEnv, *, seed: int | None = None, on_error: str = "truncate", keep_open: bool = False
    ) -> SyncVectorEnv:
        """Return a vector environment of one slot, which begins with a given environment and does not make its own.

        A replacement, when it is needed, is the environment's own ``spawn``.

        Args:
            env: What the slot begins with.
            seed: Seed of the run; None draws one.
            on_error: ``"truncate"`` or ``"raise"``.
            keep_open: Leave closing ``env`` to the caller; replacements are closed in any case.
        """
        spares = [env]

        def factory(env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
            if env_id is not None and env_id != getattr(env.unwrapped, "env_id", None):
                raise ArgumentError(f"the plan asks for {env_id!r}, and the environment given is {env}")
            if spares and not overrides:
                return spares.pop()
            return cast("AnyEnv", env.get_wrapper_attr("spawn")(**overrides))

        self = cls.__new__(cls)
        self._set_up([getattr(env.unwrapped, "env_id", None)], [factory], new_source(None, seed), on_error)
        self._slots[0].borrowed = env if keep_open else None
        return self

    def _set_up(self, ids: list[str | None], factories: list[EnvFactory], source: DrawSource, on_error: str) -> None:
        self.ids, self.all_ids = ids, list(dict.fromkeys(ids))
        self._source = self._own_source = source
        self._budget = FaultBudget(limit=max(16, 2 * len(ids)))
        self._slots = [
            Slot(index, own_id, factory, source, self._budget, on_error)
            for index, (own_id, factory) in enumerate(zip(ids, factories, strict=True))
        ]
        self._begun = False

    @property
    def seed(self) -> int:
        """Seed of the run."""
        return self._source.seed

    @property
    def faults(self) -> int:
        """Number of environments that failed so far."""
        return self._budget.total

    @property
    def own_source(self) -> DrawSource:
        """What its own episodes start from; see ``VectorEnv.own_source``."""
        return self._own_source

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot; see ``VectorEnv.reset``."""
        if seed is not None:
            self._own_source = self._own_source.restarted(seed)
        return self.begin(self._own_source, options)

    def begin(self, source: DrawSource, options: dict[str, Any] | None = None) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot, drawn from a source."""
        self._source = source
        self._begun = True
        self._budget.finished()
        results = []
        for slot in self._slots:
            slot.source = source
            results.append(slot.begin(options))
        return [observation for observation, _ in results], [info for _, info in results]

    def step(self, actions: Actions) -> VectorStep:
        """Step all slots, or those that a mapping names; see ``VectorEnv.step``."""
        if not self._begun:
            raise ResetNeededError("the vector environment has not begun; call reset() before the first step()")
        slots = self._slots
        results = [slots[index].step(action) for index, action in self.indices_and_actions(actions)]
        if not results:
            empty = np.zeros(0)
            return VectorStep([], empty, empty.astype(bool), empty.astype(bool), [])
        observations, rewards, terminated, truncated, infos = zip(*results, strict=True)
        return VectorStep(list(observations), np.array(rewards), np.array(terminated), np.array(truncated), list(infos))

    def give_up(self, slot: int, fault: str | None) -> tuple[Observation, Info]:
        """Begin the next episode of a slot in the middle of one; see ``VectorEnv.give_up``."""
        return self._slots[slot].give_up(fault)

    def draw_of(self, slot: int) -> Draw | None:
        """Return what the present episode of a slot started from."""
        return self._slots[slot].draw

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` and ``wrappers`` of the environment in a slot."""
        env = self._slots[slot].env
        spec = None if env is None else cast("MadeSpec | None", env.spec)
        if env is None or spec is None:
            name = None if env is None else type(env.unwrapped).__name__
            return {"id": self.ids[slot] or name, "kwargs": {}, "wrappers": []}
        return {"id": spec.id, "kwargs": spec.overrides(), "wrappers": [list(wrapper) for wrapper in spec.wrappers]}

    def num_tasks(self, env_id: str | None) -> int | None:
        """Return the number of tasks of an environment that has a data set."""
        slot = self._slots[self.ids.index(env_id) if env_id in self.ids else 0]
        count = getattr(slot.prepare(env_id).unwrapped, "num_tasks", None)
        return count if isinstance(count, int) else None

    def sample_random_action(self, slot: int) -> str:
        """Return a valid action for the present state of a slot."""
        return self._slots[slot].sample_random_action()

    def close(self) -> None:
        """Close every environment; ``reset`` would make them again."""
        self._begun = False
        for slot in self._slots:
            slot.close()
