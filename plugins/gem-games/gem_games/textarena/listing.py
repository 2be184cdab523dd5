"""The ids under ``ta:``, with what each needs; imports nothing of textarena."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gem_core.registry import EnvSpec
from gem_games.textarena.games import GAMES

_JUDGED = ("GuessWho", "TwentyQuestions", "Debate", "ScenarioPlanning")
_FILES = ("UsedCarNegotiation", "ScorableGames")
_CLOSED = {
    "UsedCar": "textarena 0.7.4 registers it without its module",
    "BabyAiText": "it needs the package gym and the game files of BabyAI-Text, which textarena 0.7.4 does not bring",
}


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
    if family in _FILES:
        return ("never:textarena 0.7.4 does not ship the text files of this game",)
    if family in _CLOSED:
        return (f"never:{_CLOSED[family]}",)
    return (EXTRA,)
