r"""Sokoban: push boxes onto goals; they can be pushed, never pulled."""

from __future__ import annotations

from collections.abc import Sequence

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, read_direction, sizes_to_draw
from gem_games.sokoban_levels import FEWEST_ROWS, MOST_ROWS, make_level, most_boxes

_SIZES = ((6, 6), 2, 20), ((8, 8), 5, 50)

_FLOOR, _GOAL, _BOX, _BOX_ON_GOAL, _PLAYER, _PLAYER_ON_GOAL = b"-.$*@+"
_BOX_COMES = {_FLOOR: _BOX, _GOAL: _BOX_ON_GOAL}
_PLAYER_COMES = {_FLOOR: _PLAYER, _GOAL: _PLAYER_ON_GOAL, _BOX: _PLAYER, _BOX_ON_GOAL: _PLAYER_ON_GOAL}
_BOXES = {_BOX, _BOX_ON_GOAL}
_PLAYER_GOES = {_PLAYER: _FLOOR, _PLAYER_ON_GOAL: _GOAL}
_WHERE = {"up": "above you", "down": "below you", "left": "to your left", "right": "to your right"}
_COLOURS = {"#": "dim", "-": "dim", ".": "magenta", "$": "yellow", "*": "green", "@": "cyan", "+": "cyan"}
_PICTURES = {"#": "██", "-": "  ", ".": "◇ ", "$": "■ ", "*": "■ ", "@": "☺ ", "+": "☺ "}


class SokobanEnv(Game):
    r"""Push all boxes onto goals with moves such as ``\boxed{up}``.

    - All boxes on goals: reward 1, the game is won.
    - Another step or push: reward 0.
    - A step into a wall, or against a box that cannot move: reward 0, nothing moves.
    - In the last turn, whichever of these it is: the share of the boxes that are on goals.
    - Not a direction, in letters of any case: reward -0.1, the game is over.

    Every level can be won within its turns, with a quarter of them to spare; in gem-llm's levels that is left to
    chance. A player who stands on a goal is drawn apart (``+``), whereas gem-llm's board then hides the goal.

    Args:
        dim_room: Rows and columns, the outer walls included.
        max_turns: Moves allowed.
        num_boxes: Boxes, and goals.
        format_error_ends: See ``Game``.

    Where one of the first three is None, a size is drawn from 6x6 with 2 boxes and 20 turns, and 8x8 with 5 boxes and
    50 turns, and what was given replaces its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem; the characters of
    the board are those of XSokoban, with ``-`` for the floor.
    """

    unreadable = "is not one of up, down, left and right."

    def __init__(
        self,
        dim_room: Sequence[int] | None = (6, 6),
        max_turns: int | None = 100,
        num_boxes: int | None = 3,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_whole("num_boxes", num_boxes, 1, most_boxes(MOST_ROWS, MOST_ROWS))
        room = None if dim_room is None else _checked_room(dim_room)
        sizes = sizes_to_draw(_SIZES, (room, num_boxes, max_turns))
        self._sizes = [size for size in sizes if size[1] <= most_boxes(*size[0])]
        if not self._sizes:
            rows, columns = sizes[0][0]
            raise ArgumentError(
                f"a room of {rows} by {columns} has place for {most_boxes(rows, columns)} boxes, not {num_boxes}; "
                "make it larger"
            )
        self._set_size(*self._sizes[0])
        self._board = bytearray()
        self._player = 0

    def _set_size(self, room: tuple[int, int], num_boxes: int, max_turns: int) -> None:
        self.dim_room, self.num_boxes, self.max_turns = room, num_boxes, max_turns
        # The board is kept as the text that is shown: a character and a space for each cell, the last one a line break.
        width = 2 * room[1]
        self._deltas = {"up": -width, "down": width, "left": -2, "right": 2}

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self._set_size(*self._sizes[draws.below(len(self._sizes))])
        level = make_level(*self.dim_room, self.num_boxes, max(1, self.max_turns * 3 // 4), draws)
        self._set_cells(level.cells)

    def _set_cells(self, cells: str) -> None:
        columns = self.dim_room[1]
        rows = [" ".join(cells[start : start + columns]) for start in range(0, len(cells), columns)]
        self._board = bytearray("\n".join(rows).encode("ascii"))
        self._player = max(self._board.find(b"@"), self._board.find(b"+"))

    @property
    def cells(self) -> str:
        """The board as in ``Level``."""
        return self._board.decode("ascii").replace(" ", "").replace("\n", "")

    def _rules(self) -> str:
        return (
            f"Sokoban: push all boxes onto goals; there are {self.num_boxes} of each.\n"
            "A move takes you to the next cell. A box in that cell is pushed one cell on, if neither a wall nor "
            "another box is behind it; boxes cannot be pulled. A move that is not possible costs a turn and moves "
            "nothing.\n"
            "Write your move inside \\boxed{}: up, down, left or right.\n"
        )

    def _situation(self) -> str:
        return (
            "\nThe board (# wall, - floor, . goal, $ box, * box on a goal, @ you, + you on a goal):\n"
            f"{self._board.decode('ascii')}\n" + self._turns_left("Answer like \\boxed{up}: up, down, left or right.")
        )

    def _read(self, answer: str) -> str | None:
        return read_direction(answer)

    def _play(self, direction: str) -> StepResult:
        board, delta = self._board, self._deltas[direction]
        cell = self._player + delta
        found = board[cell]
        if found not in _PLAYER_COMES:
            return self._invalid(f"There is a wall {_WHERE[direction]}.", self._share_done())
        if found in _BOXES:
            behind = board[cell + delta]
            if behind not in _BOX_COMES:
                return self._invalid(f"The box {_WHERE[direction]} cannot move.", self._share_done())
            board[cell + delta] = _BOX_COMES[behind]
        board[cell] = _PLAYER_COMES[found]
        board[self._player] = _PLAYER_GOES[board[self._player]]
        self._player = cell
        if found not in _BOXES:
            return self._move(direction, f"You went {direction}.", 0.0, self._share_done())
        if _BOX not in board:
            return self._win(direction, f"You pushed a box {direction}. All boxes are on goals: well done.")
        return self._move(direction, f"You pushed a box {direction}.", 0.0, self._share_done())

    def _share_done(self) -> float:
        return self._board.count(_BOX_ON_GOAL) / self.num_boxes

    def _random_answer(self) -> str:
        """Draw a move that is possible; a player who is walled in by boxes may draw any."""
        moves = [direction for direction in self._deltas if self._can_go(direction)] or list(self._deltas)
        return moves[int(self.action_random.random() * len(moves))]

    def _can_go(self, direction: str) -> bool:
        delta = self._deltas[direction]
        found = self._board[self._player + delta]
        return found in _BOX_COMES or (found in _BOXES and self._board[self._player + 2 * delta] in _BOX_COMES)

    def _drawing(self) -> str:
        rows = self._board.decode("ascii").splitlines()
        return "\n".join("".join(painted(_PICTURES[cell], _COLOURS[cell]) for cell in row.split()) for row in rows)


def _checked_room(dim_room: Sequence[int]) -> tuple[int, int]:
    sides = tuple(dim_room) if isinstance(dim_room, Sequence) else ()
    if len(sides) == 2 and all(type(side) is int and FEWEST_ROWS <= side <= MOST_ROWS for side in sides):
        return sides[0], sides[1]
    raise ArgumentError(
        f"dim_room must be two whole numbers from {FEWEST_ROWS} to {MOST_ROWS}, rows and columns, or None to draw it, "
        f"not {dim_room!r}"
    )
