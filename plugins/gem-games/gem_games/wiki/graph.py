"""The interface of an article graph: what WikiGame asks of a collection of articles, wherever it is kept."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from gem_core.errors import GemError
from gem_core.types import Concurrency
from gem_games.cheap_random import CheapRandom

_ATTEMPTS = 10


class ArticleError(GemError):
    """An article could not be had, whatever the agent did: the collection failed, never the agent."""


class ArticleNotFound(ArticleError):
    """The collection works and has no article of this title."""


@dataclass(frozen=True, slots=True, eq=False)
class Article:
    """An article of a collection.

    Args:
        title: Its own title, also where it was asked for by another one that leads to it.
        text: Its text or the beginning of it, as plain sentences.
        links: Titles of the articles that it links to, each once, without itself.
    """

    title: str
    text: str
    links: tuple[str, ...]


class Pair(NamedTuple):
    """Where a game starts and where it is to end.

    Args:
        start: Title of an article.
        target: Title of another one that can be reached from it.
        distance: Links that lead there; the fewest, if the collection is small enough to know.
    """

    start: str
    target: str
    distance: int


class ArticleGraph(ABC):
    """A collection of articles that link to each other.

    A collection of your own defines ``article`` and ``random_article`` and is given to the game as ``backend``. Both
    are plain calls, and both may come from several threads at once.
    """

    concurrency: ClassVar[Concurrency] = "thread"
    """``"inline"`` for articles in memory, ``"thread"`` where fetching one waits for input and output."""

    @abstractmethod
    def article(self, title: str) -> Article:
        """Return an article by its title or by another title that leads to it.

        Raises:
            ArticleNotFound: There is none.
            ArticleError: It could not be fetched; the message says what to do.
        """

    @abstractmethod
    def random_article(self, draws: CheapRandom) -> Article:
        """Draw an article that has links; the same draws give the same one as long as the collection is the same.

        Raises:
            ArticleError: None could be fetched; the message says what to do.
        """

    def pair(self, draws: CheapRandom, nearest: int, farthest: int) -> Pair:
        """Draw a start and a target between which a number of links within these bounds leads.

        Here the target is the end of a walk that never takes a link which an earlier article has as well, so that only
        the articles on the way are fetched. A shorter way around may exist.

        Raises:
            ArticleError: An article could not be fetched, or no walk was long enough.
        """
        wanted = nearest + draws.below(farthest - nearest + 1)
        for _ in range(_ATTEMPTS):
            walk = self._walk(draws, wanted)
            if len(walk) > nearest:
                return Pair(walk[0], walk[-1], len(walk) - 1)
        raise ArticleError(
            f"no walk of {nearest} links was found in {_ATTEMPTS} attempts; lower min_distance, or use a collection "
            "whose articles have more links"
        )

    def _walk(self, draws: CheapRandom, length: int) -> list[str]:
        """Return the titles on a walk of so many links, or of fewer where it comes to an end."""
        here = self.random_article(draws)
        titles, known = [here.title], {here.title}
        while len(titles) <= length:
            ways = [title for title in here.links if title not in known]
            known.update(ways)
            try:
                here = self.article(ways[draws.below(len(ways))]) if ways else here
            except ArticleNotFound:
                break
            if here.title in titles:
                break
            known.add(here.title)
            titles.append(here.title)
        return titles
