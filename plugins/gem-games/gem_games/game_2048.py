r"""Game2048: slide and merge tiles until one of them reaches a target."""

from __future__ import annotations

import math
from itertools import pairwise

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, read_direction, sizes_to_draw

_SIZES = (16, 20), (32, 30), (64, 50)
_SMALLEST_BOARD, _LARGEST_BOARD = 2, 8
_SMALLEST_TARGET, _LARGEST_TARGET = 8, 1 << 17  # what a 4x4 board can hold
_FOURS = 10  # one new tile in so many is a 4
_TILE_COLOURS = "dim", "blue", "cyan", "green", "yellow", "magenta", "red"

Line = tuple[int, ...]
"""A row or a column; 0 where there is no tile."""


class Game2048Env(Game):
    r"""Make a tile of a target by moves such as ``\boxed{left}``.

    A move slides all tiles as far as they go; two equal ones that meet become one of twice the value, once a move. Then
    a new tile appears in a free cell: a 2, or one time in ten a 4.

    - A move: the progress ``log2`` of the largest tile has made since it was last counted, as a share of what lies
      between the first largest tile and the target. The rewards of a won game add up to 1.
    - A move that changes nothing: reward 0, and no new tile.
    - The target is reached: the game is won.
    - No move is left: the game is lost.
    - The last turn is rewarded like any other.
    - Not a direction, in letters of any case: reward -0.1, the game is over.

    A 4 that appears by chance counts with the next move, as in gem-llm. The targets and turns are gem-llm's too, though
    a tile of 512 in 50 turns and one of 2048 in 100 cannot be: the tiles of a board add up to at most 4 for each move
    and 8 at the beginning. There the rewards measure how far an agent gets.

    Args:
        target_tile: A power of two from 8 to 131072; no more than 2 to the power of the number of cells.
        max_turns: Moves allowed.
        board_size: Rows, and columns.
        format_error_ends: See ``Game``.

    Where one of the first two is None, both are drawn from (16, 20), (32, 30) and (64, 50), and what was given replaces
    its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem; the game is Gabriele
    Cirulli's, https://github.com/gabrielecirulli/2048.
    """

    unreadable = "is not one of up, down, left and right."

    def __init__(
        self,
        target_tile: int | None = 2048,
        max_turns: int | None = 1000,
        board_size: int = 4,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_whole("board_size", board_size, _SMALLEST_BOARD, _LARGEST_BOARD)
        largest = min(_LARGEST_TARGET, 1 << board_size**2)
        check_whole("target_tile", target_tile, _SMALLEST_TARGET, largest)
        if target_tile is not None and target_tile.bit_count() != 1:
            raise ArgumentError(f"target_tile must be a power of two, not {target_tile}")
        self.board_size = board_size
        self._sizes = [size for size in sizes_to_draw(_SIZES, (target_tile, max_turns)) if size[0] <= largest]
        self.target_tile, self.max_turns = self._sizes[0]
        self.board: list[Line] = [(0,) * board_size] * board_size
        self.first_tile = self.largest_tile = 2

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self.target_tile, self.max_turns = self._sizes[draws.below(len(self._sizes))]
        cells = self.board_size**2
        self.board = [(0,) * self.board_size] * self.board_size
        self._add_tile(draws.below(cells * _FOURS))
        self._add_tile(draws.below((cells - 1) * _FOURS))
        self.first_tile = self.largest_tile = max(map(max, self.board))

    def _add_tile(self, number: int) -> None:
        """Put a tile into a free cell; ``number`` is below ten times the number of free cells."""
        free, kind = divmod(number, _FOURS)
        for row, line in enumerate(self.board):
            count = line.count(0)
            if free < count:
                self.board[row] = _with_tile(line, free, 2 if kind else 4)
                return
            free -= count

    def _rules(self) -> str:
        return (
            f"2048: make a tile of {self.target_tile}.\n"
            "A move slides all tiles one way as far as they go, and two equal tiles that meet become one of twice the "
            "value. After each move a 2, or now and then a 4, appears in a free cell. A move that changes nothing "
            "costs a turn; when no move is left, the game is lost.\n"
            "Write your move inside \\boxed{}: up, down, left or right.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe goal is a tile of {self.target_tile}. The board (. is free):\n{''.join(map(_shown, self.board))}"
            + self._turns_left("Answer like \\boxed{up}: up, down, left or right.")
        )

    def _read(self, answer: str) -> str | None:
        return read_direction(answer)

    def _play(self, direction: str) -> StepResult:
        board = slide(self.board, direction)
        if board == self.board:
            return self._invalid(f"Nothing can move {direction}.")
        self.board = board
        reward = self._progress()
        free = sum(line.count(0) for line in board)
        self._add_tile(int(self.np_random.random() * free * _FOURS))
        feedback = f"The tiles went {direction}."
        if self.largest_tile >= self.target_tile:
            return self._win(direction, f"{feedback} There is a tile of {self.target_tile}: well done.", reward)
        if free == 1 and not _can_merge(board):
            return self._end("lost", f"{feedback} No move is left.", reward, direction)
        return self._move(direction, feedback, reward, reward)

    def _progress(self) -> float:
        """Return the reward for the largest tile, and count it."""
        largest = min(max(map(max, self.board)), self.target_tile)
        if largest <= self.largest_tile:
            return 0.0
        reward = math.log2(largest / self.largest_tile) / math.log2(self.target_tile / self.first_tile)
        self.largest_tile = largest
        return reward

    def _random_answer(self) -> str:
        """Draw a move that changes something; any, where the game is over and none does."""
        directions = "up", "down", "left", "right"
        moves = [move for move in directions if slide(self.board, move) != self.board] or directions
        return moves[int(self.action_random.random() * len(moves))]

    def _drawing(self) -> str:
        return "\n".join("".join(map(_painted_tile, line)) for line in self.board)


def slide(board: list[Line], direction: str) -> list[Line]:
    """Return a board after a move, without the new tile."""
    if direction == "left":
        return list(map(_to_left, board))
    if direction == "right":
        return list(map(_to_right, board))
    columns = map(_to_left if direction == "up" else _to_right, zip(*board, strict=True))
    return list(zip(*columns, strict=True))


def _to_left(line: Line) -> Line:
    """Slide a line to its beginning."""
    merged: list[int] = []
    may_merge = False
    for tile in filter(None, line):
        if may_merge and merged[-1] == tile:
            merged[-1], may_merge = 2 * tile, False
        else:
            merged.append(tile)
            may_merge = True
    return (*merged, *[0] * (len(line) - len(merged)))


def _to_right(line: Line) -> Line:
    """Slide a line to its end."""
    return _to_left(line[::-1])[::-1]


def _with_tile(line: Line, free: int, tile: int) -> Line:
    """Put a tile into a free cell of a line, counted from 0."""
    cells = [place for place, old in enumerate(line) if not old]
    return (*line[: cells[free]], tile, *line[cells[free] + 1 :])


def _shown(line: Line) -> str:
    """Return a row as text."""
    return " ".join(f"{tile or '.':>4}" for tile in line) + "\n"


def _can_merge(board: list[Line]) -> bool:
    """Say whether equal tiles lie side by side."""
    lines = [*board, *zip(*board, strict=True)]
    return any(tile == after for line in lines for tile, after in pairwise(line))


def _painted_tile(tile: int) -> str:
    colour = _TILE_COLOURS[min(tile.bit_length() // 2, len(_TILE_COLOURS) - 1)]
    return painted(f"{tile or '·':>6}", colour)
