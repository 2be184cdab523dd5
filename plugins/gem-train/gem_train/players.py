"""Scripted players to imitate: they show what a response looks like, and play without skill."""

from __future__ import annotations

import re

import numpy as np

from gem_core.env import stable_hash
from gem_core.rollouts import Context
from gem_core.types import Observation

_RANGE = re.compile(r"The number is from (-?\d+) to (-?\d+)\.", re.ASCII)
_HINT = re.compile(r"(higher|lower) than (-?\d+)", re.ASCII)
_HAND = re.compile(r"player and hold the (jack|queen|king)\. Moves so far: ([a-z, ]+)\.")
_CHIPS = {"jack": 0.25, "queen": 0.5, "king": 0.75}
_SLIPS = 0.04

_QUESTION = re.compile(r"(\d+) ([+*]) (\d+)", re.ASCII)
_RESULT = re.compile(r"^Output of python:\n(\d+)$", re.ASCII | re.MULTILINE)
_USES_TOOL, _ASKS_AGAIN, _RIGHT_SUMS = 0.3, 0.2, 0.9


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


def tool_player(observation: Observation, context: Context) -> str:
    r"""Answer a sum or a product of two numbers, three times in ten with the tool ``python``, whatever is asked.

    By itself it is right about nine sums in ten, and never knows a product: it says that of any two such numbers. What
    the tool said it answers, but one time in five it runs the same code again.
    """
    left, sign, right = _QUESTION.findall(str(observation))[0]
    shown = str(context.observation)
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    result = _RESULT.search(shown)
    if random.random() < (_ASKS_AGAIN if result else _USES_TOOL):
        return f"<python>{left} {sign} {right}</python>"
    if result:
        answer = result[1]
    elif sign == "*":
        answer = str(random.integers(11, 31) * random.integers(11, 31))
    else:
        slip = 0 if random.random() < _RIGHT_SUMS else random.integers(-3, 4)
        answer = str(max(int(left) + int(right) + slip, 0))
    return f"\\boxed{{{answer}}}"


def kuhn_player(observation: Observation, context: Context) -> str:
    r"""Play KuhnPoker: bet or call with the king three times of four, with the queen twice, with the jack once."""
    shown = str(context.observation)
    card, played = _HAND.findall(shown)[-1]
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    puts_in = random.random() < _CHIPS[card]
    if played.endswith("bet"):
        return "\\boxed{call}" if puts_in else "\\boxed{fold}"
    return "\\boxed{bet}" if puts_in else "\\boxed{check}"
