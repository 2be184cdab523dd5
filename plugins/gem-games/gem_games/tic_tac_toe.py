r"""TicTacToe: three marks in a row on a board of 3x3, for two seats; with all best moves of every position."""

from __future__ import annotations

from functools import cache

from gem_games.cheap_random import CheapRandom
from gem_games.game import painted
from gem_games.joint_game import JointGame

_LINES = (0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6)
_EMPTY = "123456789"
_TEMPLATE = "\n---+---+---\n".join([" %s | %s | %s"] * 3)
_COLOURS = {"X": "cyan", "O": "yellow"}


class TicTacToeEnv(JointGame):
    r"""Take cells of a 3x3 board in turn, by moves such as ``\boxed{5}``; X begins.

    - Three cells in a row, a column or a diagonal: reward 1, and -1 for the other seat.
    - A full board without such a line: a draw, and 0 for both.
    - An answer that is no free cell does nothing; the third in a row loses. See ``JointGame``.

    Nothing is drawn: every seed gives the same game. With perfect play it is a draw.
    """

    possible_agents = ("X", "O")
    unreadable = "is not a cell from 1 to 9."

    def __init__(self) -> None:
        super().__init__()
        self.board = _EMPTY
        """Row by row, the mark in each cell, or its number while it is free."""

    def _deal(self, draws: CheapRandom) -> None:
        self.board = _EMPTY

    def _rules(self, seat: str) -> str:
        return (
            "Tic-tac-toe: X and O take turns to mark a free cell of a 3x3 board; X begins.\n"
            "Whoever first has three marks in a row, a column or a diagonal wins; a full board without such a line is "
            "a draw.\n"
            "Write the number of a free cell inside \\boxed{}.\n"
        )

    def _situation(self, seat: str) -> str:
        todo = self._ending(seat) if self.outcomes else "Answer like \\boxed{5}, with the number of a free cell."
        return f"\n{_TEMPLATE % tuple(self.board)}\nYou play {seat}. {todo}"

    def _read(self, answer: str) -> str | None:
        return answer if len(answer) == 1 and answer in _EMPTY else None

    def _fault(self, seat: str, move: str) -> str:
        return "" if move in self.board else f"Cell {move} is taken by {self.board[int(move) - 1]}."

    def _play(self, moves: dict[str, str]) -> tuple[dict[str, float], bool]:
        ((seat, cell),) = moves.items()
        self.board = self.board.replace(cell, seat)
        for each in self.possible_agents:
            self._tell(each, f"{'You' if each == seat else seat} took cell {cell}.")
        if _has_line(self.board, seat):
            return {each: 1.0 if each == seat else -1.0 for each in self.possible_agents}, True
        return {}, not free_cells(self.board)

    def _random_answer(self, seat: str) -> str:
        """Draw a free cell."""
        cells = free_cells(self.board)
        return cells[int(self.action_random.random() * len(cells))]

    def _drawing(self) -> str:
        return _TEMPLATE % tuple(painted(cell, _COLOURS.get(cell, "dim")) for cell in self.board)


def free_cells(board: str) -> str:
    """Return the numbers of the free cells of a board."""
    return board.replace("X", "").replace("O", "")


def best_moves(board: str, seat: str) -> list[str]:
    """Return all moves after which a perfect opponent can do no better than after any other.

    Args:
        board: As ``TicTacToeEnv.board``; the game is not over.
        seat: Whose turn it is.
    """
    values = {cell: -_value(board.replace(cell, seat), _other(seat)) for cell in free_cells(board)}
    best = max(values.values())
    return [cell for cell, value in values.items() if value == best]


@cache
def _value(board: str, seat: str) -> int:
    """Return what a game is worth to the seat whose turn it is, between perfect players: 1, 0 or -1."""
    if _has_line(board, _other(seat)):
        return -1
    cells = free_cells(board)
    return max((-_value(board.replace(cell, seat), _other(seat)) for cell in cells), default=0)


def _has_line(board: str, seat: str) -> bool:
    return any(board[a] == board[b] == board[c] == seat for a, b, c in _LINES)


def _other(seat: str) -> str:
    return "O" if seat == "X" else "X"
