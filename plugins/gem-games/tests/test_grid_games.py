"""What Minesweeper, FifteenPuzzle, Sudoku, Game2048 and Sokoban all promise, for each of their ids."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_games.fifteen_puzzle import FifteenPuzzleEnv
from gem_games.game import read_direction, sizes_to_draw
from gem_games.minesweeper import MinesweeperEnv
from gem_games.sokoban import SokobanEnv
from gem_games.sudoku import SudokuEnv

# The parameters and turn limits of gem-llm; clues of Sudoku are given ones here, and dim_room has one name.
PARAMETERS: dict[str, dict[str, Any]] = {
    "game:Minesweeper-v0-easy": {"rows": 5, "cols": 5, "num_mines": 5, "max_turns": 25},
    "game:Minesweeper-v0-hard": {"rows": 8, "cols": 8, "num_mines": 12, "max_turns": 64},
    "game:Minesweeper-v0-random": {"rows": None, "cols": None, "num_mines": None, "max_turns": None},
    "game:FifteenPuzzle-v0-easy": {"num_rows": 2, "max_turns": 10},
    "game:FifteenPuzzle-v0-hard": {"num_rows": 4, "max_turns": 50},
    "game:FifteenPuzzle-v0-random": {"num_rows": None, "max_turns": None},
    "game:Sudoku-v0-easy": {"clues": 7, "max_turns": 15, "scale": 4},
    "game:Sudoku-v0-hard": {"clues": 34, "max_turns": 50, "scale": 9},
    "game:Sudoku-v0-random": {"clues": None, "max_turns": None, "scale": None},
    "game:Game2048-v0-easy": {"target_tile": 64, "max_turns": 50},
    "game:Game2048-v0-hard": {"target_tile": 512, "max_turns": 50},
    "game:Game2048-v0-extreme-hard": {"target_tile": 2048, "max_turns": 100},
    "game:Game2048-v0-random": {"target_tile": None, "max_turns": None},
    "game:Sokoban-v0-easy": {"dim_room": (6, 6), "num_boxes": 2, "max_turns": 20},
    "game:Sokoban-v0-hard": {"dim_room": (8, 8), "num_boxes": 4, "max_turns": 50},
    "game:Sokoban-v0-random": {"dim_room": None, "num_boxes": None, "max_turns": None},
}
IDS = list(PARAMETERS)


def test_registered_ids_and_parameters() -> None:
    """Every id has the parameters that published baselines were measured with."""
    assert {env_id: dict(gem.spec(env_id).kwargs) for env_id in IDS} == PARAMETERS


def test_given_parameters_stay_while_others_are_drawn() -> None:
    """What was given replaces its part of each size; what cannot be solved then is left out."""
    assert sizes_to_draw(((1, 2), (3, 2), (3, 4)), (None, 5)) == [(1, 5), (3, 5)]
    field, tiles = MinesweeperEnv(None, None, 3, None), FifteenPuzzleEnv(None, 3)
    grid, room = SudokuEnv(None, 20, None), SokobanEnv((7, 9), None, None)
    for seed in range(20):
        for env in (field, tiles, grid, room):
            env.reset(seed=seed)
        assert (field.num_mines, field.max_turns) == (3, field.rows * field.cols)
        assert (tiles.num_rows, tiles.max_turns) in ((3, 10), (3, 20), (3, 50))
        assert (grid.scale, grid.max_turns) == (4, 20)
        assert (room.dim_room, room.num_boxes, room.max_turns) in (((7, 9), 2, 20), ((7, 9), 5, 50))


@pytest.mark.parametrize("env_id", [env_id for env_id in IDS if env_id.endswith("-random")])
def test_every_size_turns_up(env_id: str) -> None:
    env = gem.make(env_id).unwrapped
    sizes = set()
    for seed in range(60):
        env.reset(seed=seed)
        sizes.add(env.max_turns)
    expected = {
        "Minesweeper": {25, 36, 49, 64},
        "FifteenPuzzle": {10, 20, 50},
        "Sudoku": {15, 50},
        "Game2048": {20, 30, 50},
        "Sokoban": {20, 50},
    }
    assert sizes == expected[env_id.removeprefix("game:").partition("-")[0]]


@given(st.text(max_size=6) | st.sampled_from(["UP", "Down", "lefT", "right", " up"]))
def test_directions_are_read_in_any_case(text: str) -> None:
    read = read_direction(text)
    assert read == (text.lower() if text.lower() in ("up", "down", "left", "right") else None)
