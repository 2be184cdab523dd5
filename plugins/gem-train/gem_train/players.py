"""Scripted players to imitate: they show what a response looks like, and play without skill."""

from __future__ import annotations

import re

import numpy as np

from gem_core.env import stable_hash
from gem_core.rollouts import Context
from gem_core.types import Observation

_RANGE = re.compile(r"The number is from (-?\d+) to (-?\d+)\.", re.ASCII)
_HINT = re.compile(r"(higher|lower) than (-?\d+)", re.ASCII)
_SLIPS = 0.04


def interval_player(observation: Observation, context: Context) -> str:
    r"""Play GuessTheNumber: write down the interval that is left, then any number of it, as ``13 to 24 \boxed{18}``.

    It seldom slips and names any number of the range, so that who imitates it has seen what comes of that.
    """
    shown = str(context.observation)
    low, high = first = tuple(map(int, _RANGE.findall(shown)[-1]))
    for side, number in _HINT.findall(shown.rpartition("Hints so far")[2]):
        low, high = (max(low, int(number) + 1), high) if side == "higher" else (low, min(high, int(number) - 1))
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    lowest, highest = first if random.random() < _SLIPS else (low, high)
    return f"{low} to {high} \\boxed{{{random.integers(lowest, highest + 1)}}}"
