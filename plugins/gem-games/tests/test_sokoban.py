"""Sokoban: its levels can be won, as their own solution and a search show; its pushes and rewards."""

from __future__ import annotations

from typing import Any

import pytest
from game_solvers import box

from gem_games.cheap_random import CheapRandom
from gem_games.sokoban import SokobanEnv
from gem_games.sokoban_levels import make_level

Boxes = frozenset[int]
CORRIDOR = "########@$.-###-$-.#########"


def corridor(**kwargs: Any) -> SokobanEnv:
    """Return a game on a small board whose rows are ``#@$.-##`` and ``#-$-.##``."""
    env = SokobanEnv((5, 7), num_boxes=2, **kwargs)
    env.reset(seed=0)
    return put(env, CORRIDOR)


def put(env: SokobanEnv, cells: str) -> SokobanEnv:
    """Put a game into a position."""
    env._set_cells(cells)
    return env


def shortest_solution(cells: str, columns: int) -> int | None:
    """Return the fewest moves that win a level, by breadth-first search over all positions; None if none do."""
    goals = frozenset(cell for cell, mark in enumerate(cells) if mark in ".*+")
    boxes = frozenset(cell for cell, mark in enumerate(cells) if mark in "$*")
    walls = {cell for cell, mark in enumerate(cells) if mark == "#"}
    start = next(cell for cell, mark in enumerate(cells) if mark in "@+"), boxes
    moves = {start: 0}
    for position in (queue := [start]):
        player, boxes = position
        if boxes == goals:
            return moves[position]
        for delta in (-columns, columns, -1, 1):
            cell = player + delta
            after = boxes
            if cell in boxes:
                if cell + delta in walls or cell + delta in boxes:
                    continue
                after = boxes ^ {cell, cell + delta}
            if cell not in walls and (cell, after) not in moves:
                moves[cell, after] = moves[position] + 1
                queue.append((cell, after))
    return None


@pytest.mark.parametrize(("room", "num_boxes", "max_turns"), [((6, 6), 2, 20), ((8, 8), 4, 50), ((8, 8), 5, 50)])
def test_many_levels_are_won_by_their_own_solution(
    room: tuple[int, int], num_boxes: int, max_turns: int, many: int
) -> None:
    """Played move by move, with a quarter of the turns left; and the board is the level's."""
    env = SokobanEnv(room, max_turns, num_boxes)
    names = {-room[1]: "up", room[1]: "down", -1: "left", 1: "right"}
    boxes_on_goals = 0
    for seed in range(many):
        env.reset(seed=seed)
        level = make_level(*room, num_boxes, max_turns * 3 // 4, CheapRandom(seed))
        assert env.cells == level.cells
        assert [level.cells.count(mark) for mark in "$*"] == [
            num_boxes - level.cells.count("*"),
            level.cells.count("*"),
        ]
        assert level.cells.count("@") + level.cells.count("+") == 1
        boxes_on_goals += level.cells.count("*")
        assert 1 <= len(level.solution) <= max_turns * 3 // 4
        results = [env.step(box(names[move])) for move in level.solution]
        assert [(result[1], result[2]) for result in results[:-1]] == [(0.0, False)] * (len(results) - 1)
        assert (results[-1][1], results[-1][4]["correct"]) == (1.0, True)
    assert boxes_on_goals < 100


def test_search_solves_many_levels(many: int) -> None:
    """Independent of how levels are made: a search of all positions finds a way that fits into the turns."""
    for seed in range(many):
        level = make_level(6, 6, 2, 15, CheapRandom(seed))
        shortest = shortest_solution(level.cells, 6)
        assert shortest is not None, f"seed {seed}"
        assert shortest <= len(level.solution) <= 15


@pytest.mark.parametrize(
    ("rows", "columns", "num_boxes", "moves"), [(5, 5, 2, 1), (5, 20, 13, 40), (20, 20, 9, 10**15)]
)
def test_odd_sizes_give_levels_too(rows: int, columns: int, num_boxes: int, moves: int) -> None:
    """However few the moves, at least one box is off its goal; however many, the work is bounded."""
    for seed in range(3):
        level = make_level(rows, columns, num_boxes, moves, CheapRandom(seed))
        assert "$" in level.cells
        assert 1 <= len(level.solution) <= moves


def test_player_on_a_goal_is_drawn_apart_and_leaves_it_there() -> None:
    env = corridor()
    env.step(box("right"))
    assert env.cells[7:14] == "#-@*-##"
    env.step(box("right"))
    assert env.cells[7:14] == "#--+$##"
    env.step(box("left"))
    assert env.cells[7:14] == "#-@.$##"
