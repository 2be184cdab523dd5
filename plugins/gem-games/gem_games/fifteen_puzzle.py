r"""FifteenPuzzle: slide numbered tiles into order, on boards of 2x2 (three tiles) up to 10x10."""

from __future__ import annotations

from functools import lru_cache

from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, read_direction, sizes_to_draw

_SIZES = (2, 10), (3, 20), (4, 50)
_FEWEST_ROWS, _MOST_ROWS = 2, 10  # the tiles of more rows would need three digits
_MOST_MOVES = 1_000
_WINDOW = 12  # on a 2x2 board, moves that never go back return to their beginning after this many
_AT_ONCE = 32  # bytes that CheapRandom gives at once
_CHOICES = 12  # a multiple of 1, 2, 3 and 4, the ways that a gap can go
_REMAINDERS = bytes(byte % _CHOICES for byte in range(256))
_LABELS = [b" _", *(b"%2d" % tile for tile in range(1, _MOST_ROWS**2))]


class FifteenPuzzleEnv(Game):
    r"""Bring the tiles into order, row by row with the gap at the end, by moves such as ``\boxed{up}``.

    A move names the way in which a tile slides into the gap: ``up`` slides the tile below the gap.

    - All tiles in order: reward 1, the game is won.
    - Another slide: reward 0.
    - A slide where there is no tile: reward 0, nothing moves.
    - In the last turn, whichever of these it is: the share of the cells, the gap's included, that hold what they
      should.
    - Not a direction, in letters of any case: reward -0.1, the game is over.

    The tiles are mixed by random moves that never go straight back, and never by more than there are turns; so every
    board can be solved in time. gem-llm always makes 100 moves: many of its boards cannot be solved within their turns,
    and of size 2x2 it has but two. Its ``-random`` variant does not start.

    Args:
        max_turns: Moves allowed.
        num_rows: Rows, and columns.
        mix_moves: Random moves that mix the tiles, at most; up to a dozen fewer are made, and never more than there are
            turns.
        format_error_ends: See ``Game``.

    Where one of the first two is None, a size is drawn from 2x2 with 10 turns, 3x3 with 20 and 4x4 with 50, and what
    was given replaces its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not one of up, down, left and right."

    def __init__(
        self,
        max_turns: int | None = 20,
        num_rows: int | None = 2,
        mix_moves: int = 100,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_whole("num_rows", num_rows, _FEWEST_ROWS, _MOST_ROWS)
        check_whole("mix_moves", mix_moves, 1, _MOST_MOVES)
        self.mix_moves = mix_moves
        self._sizes = sizes_to_draw(_SIZES, (num_rows, max_turns))
        self._set_size(*self._sizes[0])

    def _set_size(self, num_rows: int, max_turns: int) -> None:
        self.num_rows, self.max_turns = num_rows, max_turns
        # The board is kept as the text that is shown: two characters for each cell, and a space or line break.
        self._template = (b" ".join([b"%b"] * num_rows) + b"\n") * num_rows
        self._row = 3 * num_rows
        self._goal = [*_LABELS[1 : num_rows * num_rows], _LABELS[0]]
        self._solved = self._template % tuple(self._goal)
        self._put(self._goal)

    def _put(self, labels: list[bytes]) -> None:
        self._board = bytearray(self._template % tuple(labels))
        self._gap = 3 * labels.index(_LABELS[0])

    @property
    def tiles(self) -> list[int]:
        """The tiles row by row, 0 for the gap."""
        return [0 if tile == "_" else int(tile) for tile in self._board.decode("ascii").split()]

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self._set_size(*self._sizes[draws.below(len(self._sizes))])
        most = min(self.mix_moves, self.max_turns)
        moves = most - draws.below(min(_WINDOW, most))
        labels = self._goal.copy()
        place = len(labels) - 1
        for gap in gap_path(self.num_rows, moves, draws):
            labels[place] = labels[gap]
            place = gap
        labels[place] = _LABELS[0]
        if labels == self._goal:
            # As after 12 moves on a 2x2 board: one tile is taken out of its place again.
            labels[-1], labels[-2] = labels[-2], labels[-1]
        self._put(labels)

    def _rules(self) -> str:
        last = self.num_rows**2 - 1
        return (
            f"The {last}-puzzle: slide the tiles until they stand in order, from 1 at the top left to {last}, row by "
            "row, with the gap at the bottom right.\n"
            "A move slides a tile into the gap and is named for the way that the tile goes: up slides the tile below "
            "the gap, left the tile to its right. A slide where there is no tile costs a turn and moves nothing.\n"
            "Write your move inside \\boxed{}: up, down, left or right.\n"
        )

    def _situation(self) -> str:
        board = self._board.decode("ascii")
        return f"\nThe board (_ is the gap):\n{board}" + self._turns_left(
            "Answer like \\boxed{up}: up, down, left or right."
        )

    def _read(self, answer: str) -> str | None:
        return read_direction(answer)

    def _play(self, direction: str) -> StepResult:
        board, gap = self._board, self._gap
        place = self._tile_that_slides(direction)
        if place is None:
            return self._invalid(f"No tile can slide {direction}.", self._share_in_place())
        tile = board[place : place + 2]
        board[gap : gap + 2] = tile
        board[place : place + 2] = b" _"
        self._gap = place
        feedback = f"Tile {tile.decode('ascii').lstrip()} slid {direction}."
        if board == self._solved:
            return self._win(direction, f"{feedback} All tiles stand in order: well done.")
        last = self.turn >= self.max_turns
        return self._move(direction, feedback, 0.0, self._share_in_place() if last else 0.0)

    def _tile_that_slides(self, direction: str) -> int | None:
        """Return where in the text the tile is that a direction slides into the gap; None if there is none."""
        gap, row = self._gap, self._row
        if direction == "up":
            return gap + row if gap + row < len(self._board) else None
        if direction == "down":
            return gap - row if gap >= row else None
        if direction == "left":
            return gap + 3 if (gap + 3) % row else None
        return gap - 3 if gap % row else None

    def _share_in_place(self) -> float:
        cells = [bytes(self._board[place : place + 2]) for place in range(0, len(self._board), 3)]
        return sum(cell == goal for cell, goal in zip(cells, self._goal, strict=True)) / len(cells)

    def _random_answer(self) -> str:
        """Draw a slide that is possible."""
        moves = [move for move in ("up", "down", "left", "right") if self._tile_that_slides(move) is not None]
        return moves[int(self.action_random.random() * len(moves))]

    def _drawing(self) -> str:
        cells = [
            painted(f"{tile:>3}", "green" if tile == number else "yellow") if tile else "  ·"
            for number, tile in enumerate(self.tiles, start=1)
        ]
        return "\n".join("".join(cells[row : row + self.num_rows]) for row in range(0, len(cells), self.num_rows))


def gap_path(num_rows: int, moves: int, draws: CheapRandom) -> list[int]:
    """Draw the cells that the gap goes through from the bottom right, never straight back."""
    ways = _ways(num_rows)
    way = ways[-1][1]
    path = []
    for start in range(0, moves, _AT_ONCE):
        count = min(_AT_ONCE, moves - start)
        for choice in draws.below(256**count).to_bytes(count, "little").translate(_REMAINDERS):
            cell, way = ways[way[choice]]
            path.append(cell)
    return path


@lru_cache(maxsize=_MOST_ROWS)
def _ways(num_rows: int) -> list[tuple[int, tuple[int, ...]]]:
    """Return how the gap can go on without going straight back, as a graph.

    Each node stands for a cell and the one that the gap came from: the cell, and the ``_CHOICES`` nodes that may
    follow, each as often as the others. The last node is the beginning, where the gap came from nowhere.
    """
    cells = range(num_rows * num_rows)
    beside = [
        [
            other
            for other in cells
            if abs(cell // num_rows - other // num_rows) + abs(cell % num_rows - other % num_rows) == 1
        ]
        for cell in cells
    ]
    nodes = [(before, cell) for cell in cells for before in beside[cell]] + [(-1, cells[-1])]
    index = {node: number for number, node in enumerate(nodes)}
    graph = []
    for before, cell in nodes:
        onward = [index[cell, other] for other in beside[cell] if other != before]
        graph.append((cell, tuple(onward * (_CHOICES // len(onward)))))
    return graph
