"""For gallery.py with ``--measure``: players of games that no agent of a plugin plays; they read the observation.

They are short and not the best there can be; they show what a good episode looks like.
"""

from __future__ import annotations

import heapq
import json
import re
import runpy
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.resources import files
from math import isqrt
from pathlib import Path
from typing import Any

from gem_games.game_2048 import slide
from gem_games.wordle import marks_of
from gem_games.words import words

DIRECTIONS = "up", "down", "left", "right"
_CORNER = [[7, 6, 5, 4], [6, 5, 4, 3], [5, 4, 3, 2], [4, 3, 2, 1]]

Cell = tuple[int, int]
Fact = tuple[frozenset[Cell], int]
"""Some hidden cells of a minefield, and how many mines they have."""


def boxed(answer: object) -> str:
    r"""Return an answer in ``\boxed{}``."""
    return f"\\boxed{{{answer}}}"


# Words.


def wordle(observation: str) -> str:
    """Guess the first common word that agrees with all marks."""
    length = int(re.findall(r"The word has (\d+) letters", observation)[-1])
    marked = re.findall(r"^([A-Z]+):((?: [GYX])+)$", observation, re.MULTILINE)
    agreeing = (
        word
        for word in map(str.upper, words(length))
        if all(marks_of(guess, word) == marks.split() for guess, marks in marked)
        and word not in {guess for guess, _ in marked}
    )
    return boxed(next(agreeing))


def hangman(observation: str) -> str:
    """Ask for the letter that most of the words have that are still possible; say the word once few are left."""
    shown = re.findall(r"letters: ([A-Z_ ]+)$", observation, re.MULTILINE)[-1].replace(" ", "")
    tried = re.findall(r"Tried so far: (.*)\.$", observation, re.MULTILINE)[-1].split(", ")
    turns = int(re.findall(r"Turns left: (\d+)", observation)[-1])
    asked = {each for each in tried if len(each) == 1}
    form = re.compile(shown.replace("_", f"[^{''.join(sorted(asked))}0]"))
    left = [word for word in map(str.upper, words(len(shown))) if form.fullmatch(word) and word not in tried]
    if len(left) <= turns:
        return boxed(left[0])
    counts = Counter(letter for word in left for letter in set(word) - asked)
    return boxed(counts.most_common(1)[0][0])


# Grids.


def minesweeper(observation: str) -> str:
    """Reveal a cell that the numbers show to be safe, or else the one that is least likely to hide a mine."""
    rows = re.findall(r"^ {1,2}\d+((?:  [.F*0-8])+)$", observation, re.MULTILINE)
    board = {(row, column): mark for row, marks in enumerate(rows) for column, mark in enumerate(marks.split())}
    hidden = [cell for cell, mark in board.items() if mark == "."]
    facts = _deduced({fact for cell, mark in board.items() if mark.isdigit() for fact in [_fact(board, cell, mark)]})
    safe = [cell for cell in hidden if any(cell in cells and not count for cells, count in facts)]

    def danger(cell: Cell) -> float:
        return max((count / len(cells) for cells, count in facts if cell in cells), default=0.3)

    row, column = min(safe or hidden, key=danger)
    return boxed(f"reveal {row} {column}")


def _fact(board: dict[Cell, str], cell: Cell, mark: str) -> Fact:
    around = [(cell[0] + down, cell[1] + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    return frozenset(each for each in around if board.get(each) == "."), int(mark)


def _deduced(facts: set[Fact]) -> set[Fact]:
    """Return facts with what follows where one set of cells lies in another."""
    facts.discard((frozenset(), 0))
    new = facts
    for _ in range(3):
        new = {(large - small, most - few) for small, few in facts for large, most in facts if small < large} - facts
        facts = facts | new
    return facts


def game_2048(observation: str) -> str:
    """Make the move after which the large tiles stand best in a corner, and most cells are free."""
    rows = re.findall(r"^ *(?:\d+|\.)(?: +(?:\d+|\.)){2,}$", observation, re.MULTILINE)[-4:]
    board = [tuple(0 if tile == "." else int(tile) for tile in row.split()) for row in rows]
    moves = [(_worth(after), move) for move in DIRECTIONS if (after := slide(board, move)) != board]
    return boxed(max(moves)[1])


def _worth(board: list[tuple[int, ...]]) -> int:
    weighed = (
        tile * weight
        for row, weights in zip(board, _CORNER, strict=True)
        for tile, weight in zip(row, weights, strict=True)
    )
    return 20 * sum(row.count(0) for row in board) + sum(weighed)


# Searches.


class Planner:
    """Finds a way to the end when it meets a position that is not on the last one, and follows it.

    Args:
        read: Returns the position that an observation shows.
        moves: Yields the moves of a position, each with the position after it.
        left: Returns how many moves are left at least; 0 at the end.
        weight: How much that counts; 1 gives the shortest way, more a quicker search.
        most: Positions of a search; after so many it goes to the best of them.
    """

    def __init__(
        self,
        read: Callable[[str], Any],
        moves: Callable[[Any], Iterator[tuple[str, Any]]],
        left: Callable[[Any], int],
        weight: float,
        most: int,
    ) -> None:
        self.read, self.moves, self.left, self.weight, self.most = read, moves, left, weight, most
        self._plan: dict[Any, str] = {}

    def __call__(self, observation: str) -> str:
        """Return the next move; any move where no way was found."""
        position = self.read(observation)
        if position not in self._plan:
            self._search(position)
        return boxed(self._plan[position])

    def _search(self, start: Any) -> None:
        """Search by A*, and keep the way to the end, or to the best position where the search takes too long."""
        self._plan = {start: next(self.moves(start))[0]}
        came: dict[Any, tuple[Any, str]] = {}
        length = {start: 0}
        queue = [(0.0, 0, start)]
        best, least = start, self.left(start)
        while queue and least and len(length) < self.most:
            _, _, position = heapq.heappop(queue)
            for move, after in self.moves(position):
                if length[position] + 1 < length.get(after, self.most):
                    length[after], came[after] = length[position] + 1, (position, move)
                    left = self.left(after)
                    heapq.heappush(queue, (length[after] + self.weight * left, len(length), after))
                    best, least = (after, left) if left < least else (best, least)
        while best in came:
            best, move = came[best]
            self._plan[best] = move


def fifteen_puzzle() -> Planner:
    """Return a player of FifteenPuzzle; a position is the tiles row by row, 0 for the gap."""
    return Planner(_tiles, _slides, _tiles_left, weight=3.0, most=4_000)


def _tiles(observation: str) -> tuple[int, ...]:
    rows = re.findall(r"^ *(?:\d+|_)(?: +(?:\d+|_))+$", observation, re.MULTILINE)
    return tuple(0 if tile == "_" else int(tile) for row in rows for tile in row.split())


def _slides(tiles: tuple[int, ...]) -> Iterator[tuple[str, tuple[int, ...]]]:
    side, gap = isqrt(len(tiles)), tiles.index(0)
    for move, down, right in (("up", 1, 0), ("down", -1, 0), ("left", 0, 1), ("right", 0, -1)):
        row, column = gap // side + down, gap % side + right
        if 0 <= row < side and 0 <= column < side:
            after, place = list(tiles), row * side + column
            after[gap], after[place] = tiles[place], 0
            yield move, tuple(after)


def _tiles_left(tiles: tuple[int, ...]) -> int:
    side = isqrt(len(tiles))
    return sum(
        abs((tile - 1) // side - place // side) + abs((tile - 1) % side - place % side)
        for place, tile in enumerate(tiles)
        if tile
    )


def sokoban() -> Planner:
    """Return a player of Sokoban; a position is the board as text."""
    return Planner(_room, _pushes, lambda room: room.count("$"), weight=2.0, most=200_000)


def _room(observation: str) -> str:
    return "\n".join(re.findall(r"^[-#.$*@+](?: [-#.$*@+])+$", observation, re.MULTILINE)).replace(" ", "")


def _pushes(room: str) -> Iterator[tuple[str, str]]:
    columns = room.index("\n") + 1
    player = max(room.find("@"), room.find("+"))
    for move, delta in (("up", -columns), ("down", columns), ("left", -1), ("right", 1)):
        cell, beyond = player + delta, player + 2 * delta
        if room[cell] == "#" or (room[cell] in "$*" and room[beyond] not in "-."):
            continue
        after = list(room)
        if room[cell] in "$*":
            after[beyond] = "*" if room[beyond] == "." else "$"
        after[cell] = "+" if room[cell] in ".*" else "@"
        after[player] = "." if room[player] == "+" else "-"
        yield move, "".join(after)


# Samples of tasks, by the solutions that come with them.


def _reading_observations(play: Callable[[str], str]) -> Any:
    """Return a player that is sent only what is new, also where there are tools."""
    player: Any = play
    player.reads = "observation"
    return player


def terminal() -> Any:
    """Look around, type the solution of the sample task, and finish."""
    solutions: dict[str, str] = {}
    for task in files("gem_terminal").joinpath("data", "sample", "tasks").iterdir():
        instruction = task.joinpath("instruction.md").read_text(encoding="utf-8")
        solutions[instruction.strip()] = task.joinpath("solution", "solve.sh").read_text(encoding="utf-8")
    left: list[str] = []

    def play(observation: str) -> str:
        for instruction, script in solutions.items():
            if observation.startswith(instruction):
                typed = script.partition("set -eu\n")[2].strip()
                left[:] = ["<bash>ls -l /app</bash>", f"<bash>bash -eu <<'DONE'\n{typed}\nDONE</bash>", "<finish/>"]
        return left.pop(0)

    return _reading_observations(play)


def databases() -> Any:
    """Look at the tables, run the SQL that solves the sample task, and say that it is done."""
    plugin = Path(__file__).resolve().parent.parent / "plugins" / "gem-mcpmark"
    solutions: dict[str, str] = {}
    for name, (right, _) in runpy.run_path(str(plugin / "tests" / "sample_solutions.py"))["SOLUTIONS"].items():
        description = plugin / "gem_mcpmark" / "sample" / name / "description.md"
        solutions[description.read_text(encoding="utf-8").strip()[:60]] = right.strip()
    left: list[str] = []

    def call(sql: str) -> str:
        return f"<tool_call>{json.dumps({'name': 'execute_sql', 'arguments': {'sql': sql}})}</tool_call>"

    def play(observation: str) -> str:
        for beginning, sql in solutions.items():
            if beginning in observation:
                tables = "SELECT table_name FROM information_schema.tables WHERE table_schema = 'public'"
                left[:] = [call(tables), call(sql), "Done."]
        return left.pop(0)

    return _reading_observations(play)
