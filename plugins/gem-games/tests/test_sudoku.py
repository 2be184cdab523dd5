"""Sudoku: each puzzle has one solution, which a solver finds from what is shown; numbers, cells and rewards."""

from __future__ import annotations

import re
from typing import Any

import pytest
from game_solvers import box

import gem_core as gem
from gem_games.cheap_random import CheapRandom
from gem_games.sudoku import SudokuEnv
from gem_games.sudoku_grids import make_puzzle


def solutions(cells: list[int], scale: int, limit: int = 2) -> list[list[int]]:
    """Return the solutions of a puzzle up to a limit, by trying all numbers in the cell with the fewest."""
    side = int(scale**0.5)
    used: dict[tuple[str, int], set[int]] = {(kind, i): set() for kind in "rcb" for i in range(scale)}

    def units(cell: int) -> tuple[set[int], set[int], set[int]]:
        row, column = divmod(cell, scale)
        return used["r", row], used["c", column], used["b", row // side * side + column // side]

    grid, found = cells.copy(), []
    for cell, number in enumerate(grid):
        for unit in units(cell) if number else ():
            assert number not in unit
            unit.add(number)

    def search() -> None:
        choices = [
            (set(range(1, scale + 1)).difference(*units(cell)), cell) for cell, number in enumerate(grid) if not number
        ]
        if not choices:
            found.append(grid.copy())
            return
        numbers, cell = min(choices, key=lambda choice: len(choice[0]))
        for number in numbers:
            grid[cell] = number
            for unit in units(cell):
                unit.add(number)
            search()
            for unit in units(cell):
                unit.remove(number)
            if len(found) >= limit:
                break
        grid[cell] = 0

    search()
    return found


def shown(observation: str) -> list[int]:
    """Read the last grid of an observation."""
    rows = re.findall(r"^\d ([\d.| ]+)$", observation, re.MULTILINE)
    numbers = [0 if mark == "." else int(mark) for row in rows for mark in row.replace("|", " ").split()]
    return numbers


@pytest.mark.parametrize(("env_id", "scale", "empty"), [("easy", 4, 9), ("hard", 9, 47)])
def test_solver_wins_many_games(env_id: str, scale: int, empty: int, many: int) -> None:
    """From the first observation alone, of which there is exactly one solution; the rewards add up to 1."""
    env = gem.make(f"game:Sudoku-v0-{env_id}")
    for seed in range(many):
        cells = shown(env.reset(seed=seed)[0])
        assert (len(cells), cells.count(0)) == (scale**2, empty)
        (solution,) = solutions(cells, scale)
        total, result = 0.0, None
        for cell, number in enumerate(cells):
            if not number:
                result = env.step(box(f"{cell // scale + 1} {cell % scale + 1} {solution[cell]}"))
                total += result[1]
        assert result is not None
        assert (result[2], result[4]["correct"]) == (True, True)
        assert total == pytest.approx(1.0)


@pytest.mark.parametrize(("scale", "clues", "count"), [(4, 5, 300), (9, 32, 20), (9, 80, 5), (4, 15, 5)])
def test_any_number_of_clues_leaves_one_solution(scale: int, clues: int, count: int) -> None:
    draws = CheapRandom(0)
    for _ in range(count):
        puzzle, solution = make_puzzle(scale, clues, draws)
        assert scale**2 - puzzle.count(0) == clues
        assert solutions(puzzle, scale) == [solution]


def test_random_player_does_not_know_what_fits() -> None:
    """It writes every number into every empty cell, whatever stands beside it, and nearly always loses."""
    env: Any = SudokuEnv(clues=14, scale=4)
    env.reset(seed=0)
    empty = [cell for cell, number in enumerate(env.cells) if not number]
    every = {f"\\boxed{{{cell // 4 + 1} {cell % 4 + 1} {number}}}" for cell in empty for number in range(1, 5)}
    assert {env.sample_random_action() for _ in range(200)} == every
    won = 0
    for seed in range(100):
        env = gem.make("game:Sudoku-v0-easy")
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, over, _, info = env.step(env.sample_random_action())
        won += info["correct"]
    assert won <= 2
