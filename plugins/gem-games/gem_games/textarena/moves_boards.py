"""Moves of board games. Each function returns moves that are all valid now."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

from gem_games.textarena.moves_puzzles import cells

if TYPE_CHECKING:
    import random

    from gem_games.textarena.moves_talk import Sampler

_AROUND = [step for step in product((-1, 0, 1), repeat=2) if any(step)]
_WAYS = {"up": (0, 1), "down": (0, -1), "left": (-1, 0), "right": (1, 0)}


def _square(row: int, column: int, size: int) -> str:
    """Return a square's name on a board whose first row is the farthest rank."""
    return f"{chr(ord('a') + column)}{size - row}"


def _inside(row: int, column: int, size: int) -> bool:
    return 0 <= row < size and 0 <= column < size


def _free_cells(game: Any, rng: random.Random) -> Sequence[str]:
    board = game.state.game_state["board"]
    return [f"[{cell}]" for cell, (row, column) in game.cell_mapping.items() if board[row][column] == ""]


def _wild(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{mark} {cell[1:]}" for cell in _free_cells(game, rng) for mark in "XO"]


def _quantum(game: Any, rng: random.Random) -> Sequence[str]:
    free = [cell[1:-1] for cell in _free_cells(game, rng)]
    return [f"[{','.join(rng.sample(free, 2))}]"] if len(free) > 1 else ()


def _ultimate(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    following = state["next_micro_board"]
    boards = range(9) if following is None else [following]
    return [
        f"[{board} {3 * row + column}]"
        for board in boards
        if state["macro_board"][board // 3][board % 3] == " "
        for row, column, mark in cells(state["board"][board])
        if mark == " "
    ]


def _connect_four(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[col {column}]" for column, top in enumerate(game.state.game_state["board"][0]) if top == "."]


def _battleship(game: Any, rng: random.Random) -> Sequence[str]:
    board = game.state.game_state["tracking_board"][game.state.current_player_id]
    return [f"[{chr(ord('A') + row)}{column}]" for row, column, seen in cells(board) if seen == "~"]


def _memory(game: Any, rng: random.Random) -> Sequence[str]:
    matched = game.state.game_state["matched_positions"]
    covered = [cell for cell in product(range(game.grid_size), repeat=2) if cell not in matched]
    return ["[{} {} {} {}]".format(*(place for cell in rng.sample(covered, 2) for place in cell))]


def _chess(game: Any, rng: random.Random) -> Sequence[str]:
    return [f"[{move.uci()}]" for move in game.state.game_state["board"].legal_moves]


def _othello(game: Any, rng: random.Random) -> Sequence[str]:
    moves = game._valid_moves("WB"[game.state.current_player_id == 0])
    return [f"[{row}, {column}]" for row, column in moves] or ["[skip]"]


def _santorini(game: Any, rng: random.Random) -> Sequence[str]:
    moves = game._get_valid_moves(game.state.current_player_id)
    return moves.split(", ") if moves else ()


def _alquerque(game: Any, rng: random.Random) -> Sequence[str]:
    seat, board, size = game.state.current_player_id, game.state.game_state["board"], game.BOARD_N
    own, other = ("R", "B") if seat == 0 else ("B", "R")

    def ends(row: int, column: int) -> Iterator[tuple[int, int]]:
        yield from ((row + down, column + right) for down, right in game.forward_dirs[seat])
        for down, right in _AROUND:
            over = row + down, column + right
            if _inside(*over, size) and board[over[0]][over[1]] == other:
                yield row + 2 * down, column + 2 * right

    return [
        f"[{_square(row, column, size)} {_square(*end, size)}]"
        for row, column, piece in cells(board)
        if piece == own
        for end in ends(row, column)
        if _inside(*end, size) and board[end[0]][end[1]] == ""
    ]


def _breakthrough(game: Any, rng: random.Random) -> Sequence[str]:
    seat, size = game.state.current_player_id, game.board_size
    ahead = 1 if seat == 0 else -1
    return [
        f"[{chr(ord('a') + column)}{row + 1}{chr(ord('a') + end)}{row + ahead + 1}]"
        for row, column, piece in cells(game.state.game_state["board"])
        if piece == "WB"[seat]
        for end in (column - 1, column, column + 1)
        if _inside(row + ahead, end, size) and game._is_valid_move(seat, row, column, row + ahead, end)
    ]


def _crusade(game: Any, rng: random.Random) -> Sequence[str]:
    moves: Sequence[str] = game._legal_moves_for_player(game.state.current_player_id)
    return moves


def _lines_of_action(game: Any, rng: random.Random) -> Sequence[str]:
    board, size = game.state.game_state["board"], game.BOARD_N
    own, other = ("O", "X") if game.state.current_player_id == 0 else ("X", "O")

    def reached(row: int, column: int, down: int, right: int) -> tuple[int, int] | None:
        far = game._count_pieces_on_line(row, column, down, right)
        end = row + far * down, column + far * right
        if not _inside(*end, size) or board[end[0]][end[1]] == own:
            return None
        blocked = any(board[row + step * down][column + step * right] == other for step in range(1, far))
        return None if blocked else end

    return [
        f"[{_square(row, column, size)}{_square(*end, size)}]"
        for row, column, piece in cells(board)
        if piece == own
        for way in _AROUND
        if (end := reached(row, column, *way))
    ]


def _surviving(game: Any, head: tuple[int, int], taken: Container[tuple[int, int]]) -> Sequence[str]:
    """Return the ways that lead neither out of the board nor into a taken cell; all of them if none does."""
    ways = [
        f"[{way}]"
        for way, (right, up) in _WAYS.items()
        if 0 <= head[0] + right < game.width
        and 0 <= head[1] + up < game.height
        and (head[0] + right, head[1] + up) not in taken
    ]
    return ways or [f"[{way}]" for way in _WAYS]


def _snake(game: Any, rng: random.Random) -> Sequence[str]:
    snakes = game.state.game_state["snakes"]
    taken = {cell for snake in snakes.values() if snake.alive for cell in snake.positions}
    return _surviving(game, snakes[game.state.current_player_id].head, taken)


def _surround(game: Any, rng: random.Random) -> Sequence[str]:
    players = game.state.game_state["players"]
    taken = {(x, y) for y, x, trail in cells(game.state.game_state["board"]) if trail is not None}
    taken.update(player.position for player in players.values())
    return _surviving(game, players[game.state.current_player_id].position, taken)


SAMPLERS: dict[str, Sampler] = {
    "Alquerque": _alquerque,
    "Battleship": _battleship,
    "Breakthrough": _breakthrough,
    "Chess": _chess,
    "ConnectFour": _connect_four,
    "Crusade": _crusade,
    "LinesOfAction": _lines_of_action,
    "MemoryGame": _memory,
    "Othello": _othello,
    "QuantumTicTacToe": _quantum,
    "ReverseTicTacToe": _free_cells,
    "SantoriniBaseFixed": _santorini,
    "SimpleTak": _free_cells,
    "Snake": _snake,
    "Surround": _surround,
    "ThreePlayerTicTacToe": _free_cells,
    "TicTacToe": _free_cells,
    "UltimateTicTacToe": _ultimate,
    "WildTicTacToe": _wild,
}
