"""Random players for games whose moves nobody lists: forms are read from what the game says, and tried on a copy."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import random

    from gem_games.textarena.table import Table

_BRACKETED = re.compile(r"\[[^\[\]\n]{1,60}\]")
_NUMBER = re.compile(r"\d+")
_CELL = re.compile(r"\b[A-Ha-h](?=\d)|\b[A-H]\b")
_TRIES = 24
_FORMS = ("[{0}]", "[{0} {1}]", "[{0},{1}]", "[{0}, {1}]", "[{a}{0}]", "[{a}]")


def random_move(table: Table, rng: random.Random) -> str:
    """Return a move of the game's form, valid wherever 24 tries on a copy of the game find one that is."""
    candidates = list(_candidates(table, rng))
    for move in candidates:
        if table.tries(move):
            return move
    return candidates[0]


def _candidates(table: Table, rng: random.Random) -> list[str]:
    board = getattr(table.state, "game_state", None) or {}
    position: Any = board.get("board") if isinstance(board, dict) else None
    if position is not None and hasattr(position, "legal_moves"):  # a board of the package chess
        listed = [f"[{move.uci()}]" for move in position.legal_moves]
        if listed:
            return [rng.choice(sorted(listed))]
    texts = table.seen.get(table.seat, [])
    latest = list(dict.fromkeys(_BRACKETED.findall("\n".join(texts[-3:]))))
    prompt = list(dict.fromkeys(_BRACKETED.findall("\n".join(texts[:1]))))
    found = []
    for turn in range(_TRIES):
        pool = (latest, prompt, prompt, [])[turn % 4] or prompt
        if pool and turn % 4 < 3:
            found.append(_varied(rng.choice(pool), rng, change=turn % 4 == 2 or turn > _TRIES // 2))
        else:
            letter = rng.choice("abcdefgh")
            found.append(rng.choice(_FORMS).format(rng.randrange(10), rng.randrange(10), a=letter))
    return found or ["[0]"]


def _varied(form: str, rng: random.Random, *, change: bool) -> str:
    """Return a form with other numbers and letters of a board in it."""
    if not change:
        return form
    form = _NUMBER.sub(lambda match: str(rng.randrange(max(10, int(match.group()[:4]) + 1))), form)
    return _CELL.sub(lambda match: rng.choice("ABCDEFGH" if match.group().isupper() else "abcdefgh"), form)
