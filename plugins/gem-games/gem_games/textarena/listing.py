"""The ids under ``ta:``, with what each needs; imports nothing of textarena."""

from __future__ import annotations

from collections.abc import Iterator

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
    """Return a record for each game. A slash in a name of TextArena becomes a hyphen."""
    for name, players in GAMES.items():
        seats = "one player" if players < 2 else f"{players} or more players" if players > 2 else "two players"
        yield EnvSpec(
            id=f"ta:{name.replace('/', '-')}",
            entry_point="gem_games.textarena.env:TextArenaEnv",
            kwargs={"game": name, "players": max(players, 1)},
            summary=f"TextArena's {name.partition('-')[0]}; {seats}.",
            tags=("game", "text", "textarena"),
            requires=_needs(name.partition("-")[0]),
            deterministic=name.partition("-")[0] not in _JUDGED,
        )


def _needs(family: str) -> tuple[str, ...]:
    if family in _JUDGED:
        return (EXTRA, "argument:judge")
    if family in _FILES:
        return ("never:textarena 0.7.4 does not ship the text files of this game",)
    if family in _CLOSED:
        return (f"never:{_CLOSED[family]}",)
    return (EXTRA,)
