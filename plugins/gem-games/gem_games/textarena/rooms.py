"""Rooms for TextArena's Sokoban, made by our own generator: its own takes seconds to minutes for some seeds."""

from __future__ import annotations

from typing import Any

import numpy as np

from gem_games.cheap_random import CheapRandom
from gem_games.sokoban_levels import make_level

_WALL, _FLOOR, _GOAL, _BOX_ON_GOAL, _BOX, _PLAYER = range(6)
_FIXED = {"#": _WALL, "-": _FLOOR, "$": _FLOOR, "@": _FLOOR, ".": _GOAL, "*": _GOAL, "+": _GOAL}
_SHOWN = {**_FIXED, "$": _BOX, "*": _BOX_ON_GOAL, "@": _PLAYER, "+": _PLAYER}


def generate_room(dim: tuple[int, int], num_steps: int, num_boxes: int, seed: int) -> tuple[Any, Any, dict[Any, Any]]:
    """Return what TextArena's function of this name returns: the room when empty, as it stands, and no pairs.

    Both are arrays of its own numbers. Which box belongs to which goal decides nothing in its rules.

    Args:
        dim: Rows and columns, outer walls included.
        num_steps: With how many moves it can be won; both sizes of the game give more turns than that.
        num_boxes: How many boxes there are.
        seed: Where its randomness comes from.
    """
    cells = make_level(*dim, num_boxes, num_steps, CheapRandom(seed)).cells
    return _array(cells, _FIXED, dim), _array(cells, _SHOWN, dim), {}


def _array(cells: str, codes: dict[str, int], dim: tuple[int, int]) -> Any:
    return np.array([codes[cell] for cell in cells]).reshape(dim)
