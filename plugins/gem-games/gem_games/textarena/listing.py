"""The ids under ``ta:``, with what each needs; imports nothing of textarena."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gem_core.registry import EnvSpec
from gem_games.textarena.games import GAMES

_JUDGED = ("GuessWho", "TwentyQuestions", "Debate")
_NO_FILES = "textarena 0.7.4 does not ship the text files of this game"
_NO_REWARD = "textarena 0.7.4 mixes up reward and reason of an invalid move"
_NO_END = "textarena 0.7.4 raises when this game is over"
_FOR_EVER = "textarena 0.7.4 asks a seat that is eliminated again and again"
CLOSED = {
    "BabyAiText": "it needs the package gym and the game files of BabyAI-Text, which textarena 0.7.4 does not bring",
    "Bandit": "textarena 0.7.4 takes no button for the best one",
    "CharacterConclave": "textarena 0.7.4 raises when a player speaks",
    "Checkers": _NO_END,
    "Countdown": _NO_REWARD,
    "Cryptarithm": _NO_REWARD,
    "FifteenPuzzle": f"{_NO_END}; play game:FifteenPuzzle-v0-hard",
    "Klondike": "Python cannot read its module in textarena 0.7.4",
    "MarketEntryGame": _FOR_EVER,
    "PublicGoodsGame": _FOR_EVER,
    "ScenarioPlanning": _NO_END,
    "ScorableGames": _NO_FILES,
    "Slitherlink": _NO_REWARD,
    "Sokoban": "textarena 0.7.4 searches minutes for some of its rooms; play game:Sokoban-v0-hard",
    "Stratego": "textarena 0.7.4 raises after a bomb is defused",
    "Tak": _NO_END,
    "ThreeCardMonte": _NO_REWARD,
    "UsedCar": "textarena 0.7.4 registers it without its module",
    "UsedCarNegotiation": _NO_FILES,
}
"""Families that cannot be played, and why."""

EXTRA = "package:gem-games[textarena]"
"""What every game requires that can run at all."""


def textarena_specs() -> Iterator[EnvSpec]:
    """Return a record for each game, and one with all seats open if it has several.

    A slash in a name of TextArena becomes a hyphen.
    """
    for name, players in GAMES.items():
        family = name.partition("-")[0]
        seats = "one player" if players < 2 else f"{players} or more players" if players > 2 else "two players"
        same: dict[str, Any] = {
            "tags": ("game", "text", "textarena"),
            "requires": _needs(family),
            "deterministic": family not in _JUDGED,
        }
        env_id = f"ta:{name.replace('/', '-')}"
        yield EnvSpec(
            id=env_id,
            entry_point="gem_games.textarena.env:TextArenaEnv",
            kwargs={"game": name, "players": max(players, 1)},
            summary=f"TextArena's {family}; {seats}.",
            **same,
        )
        if players > 1:
            yield EnvSpec(
                id=f"{env_id}-multi",
                entry_point="gem_games.textarena.multi_agent:TextArenaMultiAgentEnv",
                kwargs={"game": name, "players": players},
                summary=f"TextArena's {family}; {seats}, all seats open.",
                seats=tuple(f"player_{seat}" for seat in range(players)),
                **same,
            )


def _needs(family: str) -> tuple[str, ...]:
    if family in _JUDGED:
        return (EXTRA, "argument:judge")
    if family in CLOSED:
        return (f"never:{CLOSED[family]}",)
    return (EXTRA,)
