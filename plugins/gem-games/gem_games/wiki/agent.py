"""The solver of WikiGame: it knows the shipped articles by heart."""

from __future__ import annotations

import re

from gem_core.errors import AgentError, ArgumentError
from gem_core.rollouts import Context
from gem_core.terminal import observation_text
from gem_core.types import Observation
from gem_games.agents import _wrong_game
from gem_games.wiki.articles import load_articles

_PLACE = re.compile(r"^Your target: (.+)\.\nYou are at: (.+)\.$", re.MULTILINE)


class WikiGameAgent:
    """Wins WikiGame with the shipped articles, in the fewest turns."""

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return the next link on a shortest way to the target.

        Raises:
            AgentError: The observation is not one of WikiGame, or its articles are not the shipped ones.
        """
        places = _PLACE.findall(observation_text(observation))
        if not places:
            raise _wrong_game("wikigame", "game:WikiGame-*", context)
        target, here = places[-1]
        try:
            way = load_articles().way(here, target)
        except ArgumentError as error:
            raise AgentError(f"agent 'wikigame' knows the shipped articles alone: {error}") from error
        return f"\\boxed{{{way[min(1, len(way) - 1)]}}}"
