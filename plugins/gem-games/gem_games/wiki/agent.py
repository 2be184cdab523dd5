"""The solver of WikiGame: it knows the embedded articles by heart."""

from __future__ import annotations

import re

from gem_core.errors import AgentError
from gem_core.rollouts import Context
from gem_core.types import Observation
from gem_games.agents import _text, _wrong_game
from gem_games.wiki.embedded import embedded_articles
from gem_games.wiki.graph import ArticleNotFound

_PLACE = re.compile(r"^Your target: (.+)\.\nYou are at: (.+)\.$", re.MULTILINE)


class WikiGameAgent:
    """Wins WikiGame with the embedded articles, in the fewest turns."""

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return the next link on a shortest way to the target.

        Raises:
            AgentError: The observation is not one of WikiGame, or its articles are not the embedded ones.
        """
        places = _PLACE.findall(_text(observation))
        if not places:
            raise _wrong_game("wikigame", "game:WikiGame-*", context)
        target, here = places[-1]
        try:
            way = embedded_articles().way(here, target)
        except ArticleNotFound as error:
            raise AgentError(f"agent 'wikigame' knows the embedded articles alone: {error}") from error
        return f"\\boxed{{{way[min(1, len(way) - 1)]}}}"
