"""Actions and results of a vector environment, and the checks of its arguments."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import Any, NamedTuple, SupportsIndex, cast

import numpy as np
import numpy.typing as npt

from gem_core.env.checks import check_actions
from gem_core.errors import ArgumentError
from gem_core.types import Action, Info, Observation

Actions = Sequence[Action] | Mapping[int, Action]
"""One action for each slot, in order; or ``{slot: action}`` for some slots."""


class VectorStep(NamedTuple):
    """Results of the slots that were stepped, in the order in which the caller named them.

    Args:
        observations: One for each slot; ``{agent: observation}`` if several agents act.
        rewards: float64, (slots,). If several agents act in a slot: a list, with ``{agent: reward}`` for that slot.
        terminated: bool, (slots,).
        truncated: bool, (slots,).
        infos: One for each slot.
    """

    observations: list[Observation]
    rewards: npt.NDArray[np.float64]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    infos: list[Info]


class Received(NamedTuple):
    """Result of ``recv``: the slots that are ready, in order of completion, and the result of each.

    Args:
        slots: Numbers of the slots.
        observations: One for each slot, as in all following fields; see ``VectorStep``.
        rewards: float64, (slots,); or a list.
        terminated: bool, (slots,).
        truncated: bool, (slots,).
        infos: One for each.
    """

    slots: list[int]
    observations: list[Observation]
    rewards: npt.NDArray[np.float64]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    infos: list[Info]


def paired(actions: Actions, num_envs: int) -> Iterable[tuple[int, Action]]:
    """Return the numbers of the slots to step, each with its action, in the order given.

    Raises:
        ArgumentError: The number of actions differs from the number of slots, or a slot does not exist.
    """
    if isinstance(actions, Mapping):
        return [(checked_slot(slot, num_envs), action) for slot, action in actions.items()]
    if isinstance(actions, str) or not hasattr(actions, "__len__") or len(actions) != num_envs:
        given = "one string" if isinstance(actions, str) else f"a {type(actions).__name__}"
        if isinstance(actions, Sized) and not isinstance(actions, str):
            given = f"{len(actions)} actions"
        raise ArgumentError(f"{given} for {num_envs} slots; give one for each, or a mapping of slot to action")
    return enumerate(actions)


def masked_slots(mask: Any, num_envs: int) -> list[int]:
    """Return the slots that a mask of bools selects.

    Raises:
        ArgumentError: The mask is not one bool for each slot.
    """
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_:
        raise ArgumentError(f"reset_mask must be {num_envs} bools, one for each slot, not {mask!r:.200}")
    return [int(slot) for slot in np.flatnonzero(array)]


def checked_slot(slot: SupportsIndex, num_envs: int) -> int:
    """Return the number of a slot as an ``int``.

    Raises:
        ArgumentError: There is no such slot.
    """
    try:
        index = operator.index(slot)  # accepts the integers of NumPy, as its index functions return them
    except TypeError:
        index = -1
    if not 0 <= index < num_envs:
        raise ArgumentError(f"no slot {slot!r}; there are slots 0 to {num_envs - 1}")
    return index


def check_action(slot: int, action: object, observation: object) -> None:
    """Refuse an action that does not fit the last observation of a slot.

    Raises:
        ArgumentError: It is no text. Or one action is given and several agents act, or the other way round; or an
            action is missing, or unwanted.
    """
    if isinstance(observation, dict):
        check_actions(observation, cast("Mapping[str, str]", action), f" in slot {slot}")
    elif not isinstance(action, str):
        kind = type(action).__name__
        raise ArgumentError(f"one agent acts in slot {slot}: its action is a str or a Response, not a {kind}")
