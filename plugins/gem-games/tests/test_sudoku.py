"""Sudoku: each puzzle has one solution, which a solver finds from what is shown; numbers, cells and rewards."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem
from gem_games.cheap_random import CheapRandom
from gem_games.sudoku import SudokuEnv
from gem_games.sudoku_grids import make_puzzle

SOLUTION = [1, 2, 3, 4, 3, 4, 1, 2, 2, 1, 4, 3, 4, 3, 2, 1]


def box(answer: object) -> str:
    return f"I write \\boxed{{{answer}}}."


def small(*empty: int, **kwargs: Any) -> SudokuEnv:
    """Return a 4x4 game whose solution is known, with some empty cells."""
    env = SudokuEnv(clues=16 - len(empty), scale=4, **kwargs)
    env.reset(seed=0)
    cells = [0 if cell in empty else number for cell, number in enumerate(SOLUTION)]
    env.solution = list(SOLUTION)
    env._put(cells)
    return env


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


def test_solver_finds_several_solutions_where_there_are() -> None:
    """So that the tests above can fail."""
    assert len(solutions([0] * 16, 4)) == 2


def test_grids_vary() -> None:
    """Every number turns up in every cell, and no two grids are the same."""
    draws = CheapRandom(0)
    grids = [tuple(make_puzzle(9, 60, draws)[1]) for _ in range(150)]
    assert len(set(grids)) == 150
    assert all(len({grid[cell] for grid in grids}) == 9 for cell in range(81))


def test_wrong_number_is_not_written_down() -> None:
    """One that its row, column and box do not have yet: it was worth a try."""
    env = small(0, 1, 4, 5, 8, 9)
    _, reward, terminated, _, info = env.step(box("1 1 2"))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, "1 1 2")
    assert (info["feedback"], env.cells[0]) == ("2 is wrong in row 1, column 1.", 0)


def test_random_player_does_not_know_what_fits() -> None:
    """It writes every number into every empty cell, whatever stands beside it, and nearly always loses."""
    env = small(0, 5)
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
