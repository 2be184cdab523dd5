r"""Actions and observations of Gymnasium's spaces as text: numbers and names in ``\boxed{}``, arrays in few lines."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from gem_core.env import Content, Messages, Text
from gem_core.errors import ArgumentError
from gem_core.parsing import extract_last_boxed_answer, without_thinking
from gem_core.types import Observation

_ARRAYS = (spaces.Box, spaces.MultiDiscrete, spaces.MultiBinary)
_TEXTS = (Text, spaces.Text)
_MANY = 20
"""More numbers in a row than this are told by the first and the last."""

_MAX_NUMBERS = 20_000
"""Of an array that has more, the corners are shown; a board of chess has 7,104 numbers."""

_NUMBER = re.compile(r"[+-]?\d{1,18}", re.ASCII)


class ActionText:
    r"""The actions of one agent as text.

    An action of a ``Discrete`` space is its number or name in ``\boxed{}``; of ``Box``, ``MultiDiscrete`` and
    ``MultiBinary`` all its numbers, in the order of the array; of a text space the whole response.

    Args:
        space: Of the actions.
        names: Names of the actions of a ``Discrete`` space, the lowest number first; empty where they have none.

    Raises:
        ArgumentError: There is no text for actions of such a space, or the names do not fit.
    """

    def __init__(self, space: spaces.Space[Any], names: Sequence[str] = ()) -> None:
        if not isinstance(space, (spaces.Discrete, *_ARRAYS, *_TEXTS)):
            raise ArgumentError(f"there is no text form for actions of {space}; give read=, a function (agent, text)")
        if names and not (isinstance(space, spaces.Discrete) and len(names) == space.n):
            raise ArgumentError(f"action_names has {len(names)} names, and the actions are {space}")
        self.space = space
        self.names = list(names)

    def write(self, action: Any) -> str:
        """Return what stands for an action in the box; of a text space the action itself."""
        if isinstance(self.space, spaces.Discrete):
            return self.names[int(action) - int(self.space.start)] if self.names else str(int(action))
        return str(action) if isinstance(self.space, _TEXTS) else " ".join(map(str, np.ravel(action).tolist()))

    def read(self, text: str) -> Any:
        """Return the action in a response without its thinking; None if there is none. It need not be legal now."""
        if isinstance(self.space, _TEXTS):
            return text
        answer = extract_last_boxed_answer(without_thinking(text))
        if answer is None:
            return None
        if not isinstance(self.space, spaces.Discrete):
            return self._array(answer)
        folded = [name.casefold() for name in self.names]
        if answer.casefold() in folded:
            return int(self.space.start) + folded.index(answer.casefold())
        return int(answer) if _NUMBER.fullmatch(answer) else None

    def _array(self, answer: str) -> Any:
        words = answer.strip("[]()").replace(",", " ").split()
        if len(words) != np.prod(self.space.shape or (), dtype=int):
            return None
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            return None
        with np.errstate(all="ignore"):  # a number may be too large for the array
            action = numbers.reshape(self.space.shape or ()).astype(self.space.dtype)
        exact = np.issubdtype(action.dtype, np.floating) or np.array_equal(action.ravel(), numbers)
        return action if exact and np.isfinite(action).all() else None

    def how_to_answer(self, mask: Any) -> str:
        """Say how a legal action is written; nothing for a text space."""
        if isinstance(self.space, _TEXTS):
            return ""
        if isinstance(self.space, spaces.Discrete):
            numbers = legal_numbers(self.space, mask)
            if not self.names and len(numbers) == numbers[-1] - numbers[0] + 1 > _MANY:
                return f"Answer with a number from {numbers[0]} to {numbers[-1]} in a box, as \\boxed{{{numbers[0]}}}."
            legal = list(map(self.write, numbers))
            return f"Answer with one of {', '.join(legal)} in a box, as \\boxed{{{legal[0]}}}."
        count = np.prod(self.space.shape or (), dtype=int)
        return (
            f"Answer with {count} numbers inside \\boxed{{}}, with blanks between them; the array is of {self.space}."
        )

    def sample(self, mask: Any, random: np.random.Generator) -> str:
        """Return a response with a random legal action."""
        if isinstance(self.space, spaces.Discrete):
            legal = legal_numbers(self.space, mask)
            return f"\\boxed{{{self.write(legal[int(random.integers(len(legal)))])}}}"
        space = copy.deepcopy(self.space)  # the environment may draw from its own
        space.seed(int(random.integers(2**31)))
        text = self.write(space.sample())
        return text if isinstance(self.space, _TEXTS) else f"\\boxed{{{text}}}"


def legal_numbers(space: spaces.Discrete[Any], mask: Any) -> list[int]:
    """Return the numbers of the actions that a mask allows; all without a mask, or if it allows none."""
    numbers = range(int(space.start), int(space.start) + int(space.n))
    allowed = [] if mask is None else [number for number, allows in zip(numbers, mask, strict=True) if allows]
    return allowed or list(numbers)


def mask_of(space: spaces.Space[Any], observation: Any, info: Mapping[str, Any]) -> Any:
    """Return which actions of a ``Discrete`` space are legal: an array of 0 and 1, or None where all are.

    Source: PettingZoo's two places for an action mask, https://pettingzoo.farama.org/api/aec/#action-masking.
    """
    if not isinstance(space, spaces.Discrete):
        return None
    if isinstance(observation, Mapping) and "action_mask" in observation:
        return observation["action_mask"]
    return info.get("action_mask")


def describe_observation(observation: Any) -> Observation:
    """Return an observation as compact text, without its action mask; text, parts and messages stay as they are."""
    if Content().contains(observation) or Messages().contains(observation):
        return cast("Observation", observation)
    if not isinstance(observation, Mapping):
        return _compact(observation)
    parts = {key: value for key, value in observation.items() if key != "action_mask"}
    if list(parts) == ["observation"]:
        return describe_observation(parts["observation"])
    return "\n".join(f"{key}: {_compact(value)}" for key, value in parts.items())


def _compact(value: Any) -> str:
    """Return an array or number as text, and arrays in what else it is; of larger ones only the corners."""
    with np.printoptions(precision=4, suppress=True, threshold=_MAX_NUMBERS):
        if isinstance(value, np.ndarray | np.generic):
            return np.array2string(np.asarray(value), separator=" ")
        return str(value)
