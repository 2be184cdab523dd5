"""Sokoban levels: a room is carved, then boxes are pulled off their goals, so that pushing them back solves it."""

from __future__ import annotations

from typing import NamedTuple

from gem_games.cheap_random import CheapRandom

FEWEST_ROWS, MOST_ROWS = 5, 20
# A longer history of pulls makes large rooms slower to carve, and hardly harder.
_MOST_MOVES_PER_BOX = 30
_TRIES = 20


class Level(NamedTuple):
    """A level, and a way to win it.

    Args:
        cells: A character a cell, row by row: ``#`` wall, ``-`` floor, ``.`` goal, ``$`` box, ``@`` player, ``*`` box
            on a goal, ``+`` player on a goal.
        solution: Moves that win: how far each takes the player in ``cells``.
    """

    cells: str
    solution: list[int]


class _Room(NamedTuple):
    """A room that is carved and has goals, each with a box on it.

    Args:
        free: For each cell, whether neither wall nor box is there.
        goals: Where the goals are.
        deltas: How far a step takes one: up, down, left, right.
    """

    free: bytearray
    goals: list[int]
    deltas: tuple[int, int, int, int]


def most_boxes(rows: int, columns: int) -> int:
    """Return how many boxes a room has place for: one for four cells inside its outer walls."""
    return (rows - 2) * (columns - 2) // 4


def make_level(rows: int, columns: int, num_boxes: int, max_moves: int, draws: CheapRandom) -> Level:
    """Return a level that can be won in at most ``max_moves`` moves; a box that begins on a goal is rare.

    Args:
        rows: Height, the outer walls included; from ``FEWEST_ROWS`` to ``MOST_ROWS``.
        columns: Width, likewise.
        num_boxes: From 1 to ``most_boxes(rows, columns)``.
        max_moves: From 1 up.
        draws: Where its randomness comes from.
    """
    budget = min(max_moves, _MOST_MOVES_PER_BOX * num_boxes)
    best, most_off, tries = Level("", []), 0, 0
    while not best.solution or (tries < _TRIES and (most_off < num_boxes or 2 * len(best.solution) < budget)):
        room = _carve(rows, columns, num_boxes, draws)
        if room is None:
            continue
        tries += 1
        level, off_goals = _pull_apart(room, budget, draws)
        if (off_goals, len(level.solution)) > (most_off, len(best.solution)):
            best, most_off = level, off_goals
    return best


def _carve(rows: int, columns: int, num_boxes: int, draws: CheapRandom) -> _Room | None:
    """Return a room whose cells are all connected, with boxes on goals; None if it came out too small."""
    inside = [row * columns + column for row in range(1, rows - 1) for column in range(1, columns - 1)]
    floor = bytearray(rows * columns)
    for cell in inside:
        floor[cell] = 1
    for _ in range(len(inside) // 4):
        floor[inside[draws.below(len(inside))]] = 0
    deltas = -columns, columns, -1, 1
    start = next(cell for cell in inside if floor[cell])
    connected = _reach(start, floor, deltas)
    if 2 * len(connected) < len(inside):
        return None
    free = bytearray(rows * columns)
    for cell in connected:
        free[cell] = 1
    # Only from these can a box be pulled; so there is a way to push it onto each of them.
    places = [cell for cell in connected if any(free[cell + delta] and free[cell + delta + delta] for delta in deltas)]
    if len(places) < num_boxes:
        return None
    goals = [places.pop(draws.below(len(places))) for _ in range(num_boxes)]
    for goal in goals:
        free[goal] = 0
    return _Room(free, goals, deltas)


def _pull_apart(room: _Room, budget: int, draws: CheapRandom) -> tuple[Level, int]:
    """Play backwards from the solved room; return the level where most boxes are off goals, and how many that are."""
    free, deltas, goals, boxes = room.free, room.deltas, set(room.goals), set(room.goals)
    walls = [not (free_cell or cell in goals) for cell, free_cell in enumerate(free)]
    came: dict[int, int] | None = None  # before the first pull the player may stand anywhere
    moves: list[int] = []
    seen = {frozenset(boxes)}
    position, length, most_off = (boxes, 0), 0, 0
    while pull := _choose(_pulls(room, boxes, came), goals, boxes, seen, draws):
        start, delta = pull
        walk = _walk(came, start + delta) if came else []
        if len(moves) + len(walk) >= budget:
            break
        box, player = start + delta, start + 2 * delta
        boxes ^= {start, box}
        free[start], free[box] = 1, 0
        seen.add(frozenset(boxes))
        moves += [*walk, delta]
        came = _reach(player, free, deltas)
        off_goals = len(boxes - goals)
        # Later is farther from the solution, so among equals the last one wins.
        if off_goals >= max(1, most_off):
            position, length, most_off = (boxes.copy(), player), len(moves), off_goals
    if not length:
        return Level("", []), 0
    return Level(_cells(walls, goals, *position), [-move for move in reversed(moves[:length])]), most_off


def _pulls(room: _Room, boxes: set[int], came: dict[int, int] | None) -> list[tuple[int, int]]:
    """Return the boxes that can be pulled, each with the step that it takes."""
    free = room.free
    return [
        (box, delta)
        for box in sorted(boxes)
        for delta in room.deltas
        if free[box + delta] and free[box + 2 * delta] and (came is None or box + delta in came)
    ]


def _choose(
    pulls: list[tuple[int, int]], goals: set[int], boxes: set[int], seen: set[frozenset[int]], draws: CheapRandom
) -> tuple[int, int] | None:
    """Draw a pull to a position that is new: off a goal if there is one, and onto a goal only if there is no other."""
    new = [(box, delta) for box, delta in pulls if frozenset(boxes ^ {box, box + delta}) not in seen]
    onto_floor = [(box, delta) for box, delta in new if box + delta not in goals]
    off_goal = [(box, delta) for box, delta in onto_floor if box in goals]
    choice = off_goal or onto_floor or new
    return choice[draws.below(len(choice))] if choice else None


def _reach(start: int, free: bytearray, deltas: tuple[int, ...]) -> dict[int, int]:
    """Return the cells that can be walked to, the nearest first, each with the step that leads into it."""
    came = {start: 0}
    for cell in (queue := [start]):
        for delta in deltas:
            beside = cell + delta
            if free[beside] and beside not in came:
                came[beside] = delta
                queue.append(beside)
    return came


def _walk(came: dict[int, int], cell: int) -> list[int]:
    """Return the steps that lead to a cell."""
    steps = []
    while delta := came[cell]:
        steps.append(delta)
        cell -= delta
    return steps[::-1]


def _cells(walls: list[bool], goals: set[int], boxes: set[int], player: int) -> str:
    cells = ["#" if wall else "-" for wall in walls]
    for goal in goals:
        cells[goal] = "."
    for box in boxes:
        cells[box] = "*" if box in goals else "$"
    cells[player] = "+" if player in goals else "@"
    return "".join(cells)
