"""The random player: draws a move that the game takes as a valid one, from what the game's own state allows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gem_games.textarena import moves_boards, moves_cards, moves_puzzles, moves_talk, moves_words

if TYPE_CHECKING:
    import random

    from gem_games.textarena.table import Table

NO_MOVE = "[no move]"
"""What is played where nothing is valid. TextArena takes it for an invalid move, and thus comes to an end."""

SAMPLERS: dict[str, moves_talk.Sampler] = {
    **moves_boards.SAMPLERS,
    **moves_cards.SAMPLERS,
    **moves_puzzles.SAMPLERS,
    **moves_talk.SAMPLERS,
    **moves_words.SAMPLERS,
}
"""By the first part of a game's id: what returns moves of which each is valid now, or none where nothing is."""


def random_move(table: Table, rng: random.Random) -> str:
    """Return a valid move, or ``NO_MOVE`` where there is none; nothing is tried, and the game is only read."""
    if table.done:
        return NO_MOVE
    sampler = SAMPLERS.get(table.name.partition("-")[0], moves_talk.remark)
    moves = sampler(table.game, rng)
    return rng.choice(moves) if moves else NO_MOVE
