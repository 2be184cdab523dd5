"""Moves of puzzles and games for one. Each function returns moves that are all valid now, as far as a player can know.

TextArena takes a wrong letter of a crossword, a wrong digit of a sudoku and a mine for invalid moves: there, a random
player makes some.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, permutations
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

from gem_games.textarena.moves_talk import Sampler, always

if TYPE_CHECKING:
    import random

_TRIES = 50


def cells(board: Sequence[Sequence[Any]]) -> Iterator[tuple[int, int, Any]]:
    """Return row, column and content of each cell."""
    return ((r, c, content) for r, row in enumerate(board) for c, content in enumerate(row))


def _crosswords(game: Any, rng: random.Random) -> Sequence[str]:
    empty = ((r, c) for r, c, content in cells(game.state.game_state["board"]) if content == "_")
    return [f"[{r} {c} {letter}]" for r, c in empty for letter in ascii_uppercase]


def _frozen_lake(game: Any, rng: random.Random) -> Sequence[str]:
    row, column = game.state.game_state["player_pos"]
    ends = {way: (row + dr, column + dc) for way, (dr, dc) in game.actions.items()}
    return [f"[{way}]" for way, end in ends.items() if all(0 <= place < game.size for place in end)]


def _2048(game: Any, rng: random.Random) -> Sequence[str]:
    rows = [list(row) for row in game.state.game_state["board"]]
    columns = [list(column) for column in zip(*rows, strict=True)]
    ways = {"Left": rows, "Right": [row[::-1] for row in rows], "Up": columns, "Down": [row[::-1] for row in columns]}

    def slides(line: list[int]) -> bool:
        return any(tile and before in (0, tile) for before, tile in pairwise(line))

    return [f"[{way}]" for way, lines in ways.items() if any(map(slides, lines))]


def _guess_the_number(game: Any, rng: random.Random) -> Sequence[str]:
    numbers = range(game.min_number, game.max_number + 1)
    return [f"[{number}]" for number in numbers if number not in game.guessed_numbers]


def _lights_out(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{rng.randrange(game.size)} {rng.randrange(game.size)}]"]


def _logic_puzzle(game: Any, rng: random.Random) -> Sequence[str]:
    marks = [
        (row, column, mark, content)
        for grid in game.game_board.values()
        for row, line in grid.items()
        for column, content in line.items()
        for mark in "XO"
    ]
    # Names are read in lower case, and made of letters only.
    return [
        f"[{row} {column} {mark}]"
        for row, column, mark, content in marks
        if content != mark and (row + column).isalpha() and (row + column).islower()
    ]


def _mastermind(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    guessed = [entry["guess"] for entry in state["history"]]
    numbers = range(1, state["num_numbers"] + 1)
    for _ in range(_TRIES):
        length = state["code_length"]
        guess = rng.choices(numbers, k=length) if state["duplicate_numbers"] else rng.sample(numbers, length)
        if guess not in guessed:
            return [f"[{' '.join(map(str, guess))}]"]
    return ()


def _minesweeper(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{r} {c}]" for r, c, revealed in cells(game.revealed) if not revealed]


def _peg_jump(game: Any, rng: random.Random) -> Sequence[str]:
    board = game.state.game_state["board"]
    jumps = game.ALLOWED_MOVES
    return [f"[{start} {end}]" for start, over, end in jumps if board[start] and board[over] and not board[end]]


def _rush_hour(game: Any, rng: random.Random) -> Sequence[str]:
    taken = {(r, c) for r, c, content in cells(game._occupied()) if content is not None}
    size = range(game.BOARD_SIZE)
    fronts = [
        (f"[{name}{sign}]", car.front(sign == "+"))
        for name, car in sorted(game.state.game_state["vehicles"].items())
        for sign in "+-"
    ]
    return [move for move, front in fronts if front not in taken and front[0] in size and front[1] in size]


def _set(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{', '.join(map(str, rng.sample(range(1, len(game.state.game_state['board']) + 1), 3)))}]"]


def _sudoku(game: Any, rng: random.Random) -> Sequence[str]:
    board = game.state.game_state["board"]
    return [f"[{r + 1} {c + 1} {digit}]" for r, c, content in cells(board) if not content for digit in range(1, 10)]


def _hanoi(game: Any, rng: random.Random) -> Sequence[str]:
    towers = game.state.game_state["towers"]
    return [
        f"[{start} {end}]"
        for start, end in permutations(towers, 2)
        if towers[start] and (not towers[end] or towers[end][-1] > towers[start][-1])
    ]


SAMPLERS: dict[str, Sampler] = {
    "2048": _2048,
    "Crosswords": _crosswords,
    "FrozenLake": _frozen_lake,
    "GuessTheNumber": _guess_the_number,
    "LightsOut": _lights_out,
    "LogicPuzzle": _logic_puzzle,
    "Mastermind": _mastermind,
    "Minesweeper": _minesweeper,
    "PegJump": _peg_jump,
    "RushHour": _rush_hour,
    "Secretary": always("[accept]", "[continue]"),
    "Set": _set,
    "Sudoku": _sudoku,
    "TowerOfHanoi": _hanoi,
}
