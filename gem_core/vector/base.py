"""``VectorEnv``: the interface that all backends share."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self, SupportsIndex

import numpy as np
import numpy.typing as npt

from gem_core.errors import ArgumentError
from gem_core.plans import Draw, DrawSource, PlanItem
from gem_core.types import Info, Observation

Actions = Sequence[str] | Mapping[int, str]


class VectorStep(NamedTuple):
    """What the slots that were stepped give, in the order asked.

    Args:
        observations: One for each slot.
        rewards: float64, (slots,).
        terminated: bool, (slots,).
        truncated: bool, (slots,).
        infos: One for each slot.
    """

    observations: list[Observation]
    rewards: npt.NDArray[np.float64]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    infos: list[Info]


class VectorEnv(ABC):
    """Many environments that are reset and stepped together, each in a slot of its own.

    It is not a ``gymnasium.vector.VectorEnv``: texts and infos come as lists.

    An episode that ends is followed by the next in the same call (autoreset ``same_step``): the observation is the new
    episode's first, and ``info["final_obs"]`` and ``info["final_info"]`` hold the last of the old. An environment that
    fails ends its episode as truncated, with ``info["final_info"]["error"]``, and is replaced. When a plan is exhausted
    a slot is idle: ``TERMINAL_STATE``, flags false, ``info["idle"]``, and its actions are ignored.
    """

    ids: list[str | None]
    """The id of each slot's own environment."""

    all_ids: list[str | None]
    """The ids that were asked for, each once; there may be more of them than slots."""

    @property
    def num_envs(self) -> int:
        """Number of slots."""
        return len(self.ids)

    @property
    @abstractmethod
    def seed(self) -> int:
        """Seed of the run, from which each episode's own is made."""

    @property
    @abstractmethod
    def faults(self) -> int:
        """Number of environments that failed so far."""

    @property
    @abstractmethod
    def own_source(self) -> DrawSource:
        """What its own episodes start from, by the plan and seed that it was made with; see ``rollout``."""

    @abstractmethod
    def begin(self, source: DrawSource, options: dict[str, Any] | None = None) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot, drawn from a source."""

    @abstractmethod
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot.

        Args:
            seed: Start the run of this seed over; None goes on with the present one, as with a plan half done.
            options: Passed to the first episode of every slot.

        Raises:
            ArgumentError: The run cannot start over, because its plan is an iterator that has been drawn from.
        """

    @abstractmethod
    def step(self, actions: Actions) -> VectorStep:
        """Step all slots, or those that a mapping names.

        Args:
            actions: One for each slot in order; or ``{slot: action}``.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist.
        """

    @abstractmethod
    def give_up(self, slot: int, fault: str | None) -> tuple[Observation, Info]:
        """Begin the next episode of a slot in the middle of one.

        Args:
            slot: Number of the slot.
            fault: What failed in the machinery of its agent, counted as a fault; None where nothing failed, as when
                the history is longer than the model takes.
        """

    @abstractmethod
    def draw_of(self, slot: int) -> Draw | None:
        """Return what the present episode of a slot started from; None when it is idle."""

    @abstractmethod
    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones) and ``wrappers`` of the environment in a slot."""

    @abstractmethod
    def num_tasks(self, env_id: str | None) -> int | None:
        """Return the number of tasks of an environment that has a data set; None for any other."""

    @abstractmethod
    def sample_random_action(self, slot: int) -> str:
        """Return a valid action for the present state of a slot."""

    @abstractmethod
    def close(self) -> None:
        """Close every environment; calling it again does nothing."""

    def indices_and_actions(self, actions: Actions) -> list[tuple[int, str]]:
        """Return the slots that are stepped, each with its action, in the order asked."""
        if isinstance(actions, Mapping):
            return [(self._checked_slot(slot), _checked_action(slot, action)) for slot, action in actions.items()]
        if isinstance(actions, str) or len(actions) != self.num_envs:
            given = "one string" if isinstance(actions, str) else f"{len(actions)} actions"
            raise ArgumentError(f"{given} for {self.num_envs} slots; give one for each, or a mapping of slot to action")
        return [(slot, _checked_action(slot, action)) for slot, action in enumerate(actions)]

    def _checked_slot(self, slot: SupportsIndex) -> int:
        try:
            index = operator.index(slot)  # whole numbers of NumPy too, as its index functions return them
        except TypeError:
            index = -1
        if not 0 <= index < self.num_envs:
            raise ArgumentError(f"no slot {slot!r}; there are slots 0 to {self.num_envs - 1}")
        return index

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self.num_envs


def _checked_action(slot: SupportsIndex, action: str) -> str:
    if isinstance(action, str):
        return action
    raise ArgumentError(f"an action is a str or a Response, and that for slot {slot} is a {type(action).__name__}")


def new_source(plan: Iterable[PlanItem] | None, seed: int | None) -> DrawSource:
    """Return the draws of a run."""
    if plan is not None and (isinstance(plan, str | Mapping) or not isinstance(plan, Iterable)):
        raise ArgumentError(f"a plan is an iterable of PlanItem records, not {type(plan).__name__}")
    return DrawSource(plan, seed)
