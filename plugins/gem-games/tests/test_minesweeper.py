"""Minesweeper: the first reveal is safe, every field can be cleared, and what reveals and flags give."""

from __future__ import annotations

import re
from typing import Any

import pytest
from game_solvers import box

import gem_core as gem
from gem_games.minesweeper import MinesweeperEnv

Cells = frozenset[tuple[int, int]]


def field(*mines: int, rows: int = 3, cols: int = 4, **kwargs: Any) -> MinesweeperEnv:
    """Return a game whose mines are known."""
    env = MinesweeperEnv(rows, cols, len(mines), **kwargs)
    env.reset(seed=0)
    env._set_mines(frozenset(mines))
    return env


def shown(observation: str) -> dict[tuple[int, int], str]:
    """Read the board of an observation."""
    rows = re.findall(r"^ {1,2}\d+((?:  [.F*0-8])+)$", observation, re.MULTILINE)
    return {(row, column): mark for row, marks in enumerate(rows) for column, mark in enumerate(marks.split())}


def known(board: dict[tuple[int, int], str]) -> tuple[Cells, Cells]:
    """Return the hidden cells that the numbers show to be safe, and those that they show to be mines.

    Each number says how many mines its hidden neighbours have; where one such set lies in another, so does the rest.
    """
    facts: set[tuple[Cells, int]] = set()
    for (row, column), mark in board.items():
        if mark.isdigit():
            around = [(r, c) for r in range(row - 1, row + 2) for c in range(column - 1, column + 2)]
            facts.add((frozenset(cell for cell in around if board.get(cell) == "."), int(mark)))
    facts.discard((frozenset(), 0))
    while True:
        safe = frozenset(cell for cells, count in facts if not count for cell in cells)
        mines = frozenset(cell for cells, count in facts if len(cells) == count for cell in cells)
        if safe:
            return safe, mines
        new = {(b - a, n - m) for a, m in facts for b, n in facts if a < b} - facts
        if not new:
            return safe, mines
        facts |= new


@pytest.mark.parametrize("variant", ["easy", "hard", "random"])
def test_many_fields_are_cleared_without_a_flag(variant: str, many: int) -> None:
    """By one who sees the mines: within the turns, for rewards that add up to 1, wherever the first reveal is."""
    env = gem.make(f"game:Minesweeper-v0-{variant}")
    task: Any = env.unwrapped
    for seed in range(many):
        env.reset(seed=seed)
        first = seed % (task.rows * task.cols)
        result = env.step(box(f"reveal {first // task.cols} {first % task.cols}"))
        total = result[1]
        assert total > 0
        assert len(task.mines) == task.num_mines
        for cell in set(range(task.rows * task.cols)) - task.mines:
            if task.shown[cell] == ".":
                result = env.step(box(f"reveal {cell // task.cols} {cell % task.cols}"))
                total += result[1]
        assert (result[2], result[4]["correct"]) == (True, True)
        assert total == pytest.approx(1.0)


@pytest.mark.parametrize("variant", ["easy", "hard"])
def test_reasoning_never_meets_a_mine(variant: str) -> None:
    """Numbers tell the truth: a solver that reads them alone loses only where it must guess."""
    env = gem.make(f"game:Minesweeper-v0-{variant}")
    won = 0
    for seed in range(250):
        env.reset(seed=seed)
        observation, _, over, _, info = env.step(box("reveal 2 2"))
        while not over:
            safe, _ = known(shown(observation))
            if not safe:
                break
            for row, column in safe:
                if not over and shown(observation)[row, column] == ".":
                    observation, reward, over, _, info = env.step(box(f"reveal {row} {column}"))
                    assert reward > 0
        won += bool(over and info["correct"])
    assert won >= 40


def test_reveal_without_mines_around_goes_on() -> None:
    """To the cells around it, and from those without mines around on; cells with flags are left."""
    env = field(0)
    env.step(box("flag 0 3"))
    _, reward, terminated, _, info = env.step(box("Reveal  2 3"))
    assert (reward, terminated, info["feedback"]) == (pytest.approx(10 / 11), False, "You revealed 10 cells.")
    assert env.shown == ".10F" + "1100" + "0000"


def test_a_mine_loses_and_shows_all() -> None:
    env = field(0, 5)
    _, reward, terminated, truncated, info = env.step(box("reveal 1 1"))
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert (info["feedback"], env.shown) == ("You revealed a mine.", "*....*......")


def test_random_actions_are_left_when_all_hidden_cells_have_flags() -> None:
    """A flag is then taken away."""
    env = field(0, rows=1, cols=4)
    for column in range(4):
        env.step(box(f"flag 0 {column}"))
    assert re.fullmatch(r"\\boxed\{flag 0 [0-3]\}", env.sample_random_action())
