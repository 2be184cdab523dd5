"""FifteenPuzzle: its boards can be solved, by search and by undoing the mixing; slides and rewards."""

from __future__ import annotations

from collections import Counter

import pytest
from game_solvers import box

from gem_games.cheap_random import CheapRandom
from gem_games.fifteen_puzzle import FifteenPuzzleEnv, gap_path

Tiles = tuple[int, ...]


def distances(num_rows: int) -> dict[Tiles, int]:
    """Return how many slides each board that can be solved is away from order, by breadth-first search."""
    start = (*range(1, num_rows * num_rows), 0)
    found = {start: 0}
    for tiles in (queue := [start]):
        gap = tiles.index(0)
        for beside in (gap - num_rows, gap + num_rows, gap - 1, gap + 1):
            if not 0 <= beside < len(tiles) or (abs(beside - gap) == 1 and beside // num_rows != gap // num_rows):
                continue
            after = list(tiles)
            after[gap], after[beside] = after[beside], 0
            if (key := tuple(after)) not in found:
                found[key] = found[tiles] + 1
                queue.append(key)
    return found


@pytest.mark.parametrize(("num_rows", "max_turns"), [(2, 10), (3, 20)])
@pytest.mark.few(1)
def test_search_reaches_many_boards_within_the_turns(num_rows: int, max_turns: int, many: int) -> None:
    env, away = FifteenPuzzleEnv(max_turns, num_rows), distances(num_rows)
    for seed in range(many):
        env.reset(seed=seed)
        assert 0 < away[tuple(env.tiles)] <= max_turns


@pytest.mark.parametrize(("num_rows", "max_turns"), [(2, 10), (3, 20), (4, 50), (10, 100)])
def test_taking_the_mixing_back_solves_many_boards(num_rows: int, max_turns: int, many: int) -> None:
    """In time, whatever the size."""
    env = FifteenPuzzleEnv(max_turns, num_rows)
    for seed in range(many if num_rows < 10 else 50):
        env.reset(seed=seed)
        draws = CheapRandom(seed)
        moves = max_turns - draws.below(min(12, max_turns))
        path = [num_rows**2 - 1, *gap_path(num_rows, moves, draws)]
        over, result = False, None
        for cell, before in zip(path[::-1], path[-2::-1], strict=False):
            way = {num_rows: "up", -num_rows: "down", 1: "left", -1: "right"}[before - cell]
            result = env.step(box(way))
            over = result[2]
            if over:
                break
        assert over
        assert result is not None
        assert (result[1], result[4]["correct"]) == (1.0, True)


def test_small_boards_vary() -> None:
    """gem-llm's 100 moves leave two boards of size 2x2; here all eleven turn up, and never the solved one."""
    env = FifteenPuzzleEnv(12, 2)
    boards: Counter[Tiles] = Counter()
    for seed in range(500):
        env.reset(seed=seed)
        boards[tuple(env.tiles)] += 1
    assert len(boards) == 11
    assert (1, 2, 3, 0) not in boards
