"""For maintainers of gem-games, after an upgrade of textarena: write its list of games, with their players.

``.venv/bin/python scripts/textarena_games.py`` writes ``gem_games/textarena/games.py``; then see what the tests say.
"""

from __future__ import annotations

import importlib
from pathlib import Path

from gem_games.textarena.table import Table

TARGET = Path(__file__).resolve().parent.parent / "plugins/gem-games/gem_games/textarena/games.py"
HEAD = '''"""The games that textarena 0.7.4 registers, and the fewest players of each; written by a script.

``scripts/textarena_games.py`` writes it. 0 stands for a game that did not start.
"""

GAMES: dict[str, int] = {
'''


def main() -> None:
    """Start every game with ever more players."""
    registered = importlib.import_module("textarena.envs.registration").ENV_REGISTRY

    names = [name for name in registered if not name.endswith(("-raw", "-train"))]
    lines = [f'    "{name}": {fewest_players(name)},\n' for name in names]
    TARGET.write_text(HEAD + "".join(lines) + "}\n", encoding="utf-8")


def fewest_players(name: str) -> int:
    """Return with how few players a game starts; 0 if it does not with any number up to 7."""
    failure: Exception | None = None
    for players in range(1, 8):
        try:
            table = Table(name, players, judge=lambda question: "")
            table.reset(1)
            table.look(table.seat)
            if players == 1 and not isinstance(
                table.game.state, importlib.import_module("textarena").SinglePlayerState
            ):
                continue  # it starts, and is no game: a seat is missing, or there is nobody to play against
        except Exception as error:  # noqa: BLE001 - the library asserts, and raises what it likes
            failure = error
            continue
        return players
    print(f"{name}: {type(failure).__name__}: {failure}"[:200])
    return 0


if __name__ == "__main__":
    main()
