"""Game2048: slides and merges, rewards of progress, and that its targets can be reached where their turns allow."""

from __future__ import annotations

import random
from typing import Any

import pytest
from game_solvers import box

from gem_games.game_2048 import Game2048Env, Line, slide

DIRECTIONS = "up", "down", "left", "right"
# What a tile is worth in each cell: large ones belong into one corner.
WEIGHTS = [[7, 6, 5, 4], [6, 5, 4, 3], [5, 4, 3, 2], [4, 3, 2, 1]]


def game(*rows: Line, largest: int = 2, **kwargs: Any) -> Game2048Env:
    """Return a game whose board is known."""
    env = Game2048Env(**{"target_tile": 16, "board_size": len(rows), **kwargs})
    env.reset(seed=0)
    env.board = list(rows)
    env.first_tile, env.largest_tile = 2, largest
    return env


def worth(board: list[Line]) -> int:
    free = sum(line.count(0) for line in board)
    return 20 * free + sum(
        tile * weight
        for line, weights in zip(board, WEIGHTS, strict=True)
        for tile, weight in zip(line, weights, strict=True)
    )


def wins(env: Game2048Env, seed: int, noise: float, choices: random.Random) -> bool:
    """Play the move after which the board is worth most, or now and then another."""
    env.reset(seed=seed)
    while True:
        moves = [(worth(after), move) for move in DIRECTIONS if (after := slide(env.board, move)) != env.board]
        move = choices.choice(moves)[1] if choices.random() < noise else max(moves)[1]
        result = env.step(box(move))
        if result[2]:
            return bool(result[4]["correct"])


@pytest.mark.parametrize(("target", "turns"), [(16, 20), (32, 30), (64, 50)])
def test_solver_wins_many_games(target: int, turns: int, many: int) -> None:
    """Within the turns; a game that is lost by bad luck is played again, with the same tiles, in another way."""
    env, choices = Game2048Env(target, turns), random.Random(0)
    for seed in range(many):
        assert any(wins(env, seed, 0.1 if attempt else 0.0, choices) for attempt in range(100)), f"seed {seed}"


@pytest.mark.parametrize(
    ("line", "slid"),
    [
        ((2, 0, 2, 4), (4, 4, 0, 0)),
        ((2, 2, 2, 2), (4, 4, 0, 0)),
        ((4, 2, 2, 0), (4, 4, 0, 0)),
        ((2, 2, 2, 0), (4, 2, 0, 0)),
        ((0, 0, 0, 2), (2, 0, 0, 0)),
        ((2, 4, 2, 4), (2, 4, 2, 4)),
    ],
)
def test_lines_slide_and_merge_once(line: Line, slid: Line) -> None:
    """The first pair in the way that they go; a tile that was merged does not merge again."""
    column = [(tile,) for tile in line]
    assert slide([line], "left") == [slid]
    assert slide([line[::-1]], "right") == [slid[::-1]]
    assert slide(column, "up") == [(tile,) for tile in slid]
    assert slide(column[::-1], "down") == [(tile,) for tile in slid[::-1]]


def test_a_turn_adds_one_tile() -> None:
    """A 2, or one time in ten a 4, and any free cell."""
    env = Game2048Env()
    fours, places = 0, set()
    for seed in range(1_000):
        env.reset(seed=seed)
        assert sum(map(len, env.board)) - sum(line.count(0) for line in env.board) == 2
        env.board = [(2, 0, 0, 0), *[(0,) * 4] * 3]
        env.step(box("down"))
        tiles = {(row, column): tile for row, line in enumerate(env.board) for column, tile in enumerate(line) if tile}
        assert tiles.pop((3, 0)) == 2
        ((place, tile),) = tiles.items()
        places.add(place)
        fours += tile == 4
    assert len(places) == 15
    assert 70 < fours < 130


def test_progress_is_rewarded_in_logarithms() -> None:
    """From a first tile of 2 to a target of 16 there are three steps; the rewards of a won game add up to 1."""
    env = game((2, 2, 0), (0, 0, 0), (0, 0, 0))
    rewards = [env.step(box("left"))[1]]
    for tile in (4, 8):
        env.board = [(tile, tile, 0), (0, 0, 0), (0, 0, 0)]
        _, reward, terminated, truncated, info = env.step(box("left"))
        rewards.append(reward)
    assert rewards == pytest.approx([1 / 3] * 3)
    assert (terminated, truncated, info["correct"]) == (True, False, True)


def test_no_move_left_loses() -> None:
    _, reward, terminated, truncated, info = game((0, 8), (4, 8), largest=8).step(box("left"))
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
