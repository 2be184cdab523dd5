"""The articles of WikiGame: those shipped here, a few sentences each, written for this project, or a file's."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from gem_core.errors import ArgumentError
from gem_games.cheap_random import CheapRandom

# [[Title]], or [[Title|other words]] where the sentence needs them.
_LINK = re.compile(r"\[\[([^\[\]|]+)(?:\|([^\[\]|]+))?\]\]")


@dataclass(frozen=True, slots=True, eq=False)
class Article:
    """An article.

    Args:
        title: Its title.
        text: Its text, as plain sentences.
        links: Titles of the articles that it links to, each once.
    """

    title: str
    text: str
    links: tuple[str, ...]


class Pair(NamedTuple):
    """Where a game starts and where it is to end.

    Args:
        start: Title of an article.
        target: Title of another one that can be reached from it.
        distance: The fewest links that lead there.
    """

    start: str
    target: str
    distance: int


class Articles:
    """Articles that link to each other; a link to a title without an article is plain text.

    Args:
        lines: JSON lines of ``{"title": …, "text": …}``, the links of the text marked ``[[Title]]`` or
            ``[[Title|words]]``.

    Raises:
        ArgumentError: A line is something else.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        texts: dict[str, str] = {}
        for number, line in enumerate(lines, start=1):
            try:
                record = json.loads(line)
                texts[record["title"]] = record["text"] + ""
            except (ValueError, TypeError, KeyError) as error:
                raise ArgumentError(f"line {number} of the articles is not {{'title': …, 'text': …}}") from error
        self._articles: dict[str, Article] = {}
        for title, text in texts.items():
            links = dict.fromkeys(match[1] for match in _LINK.finditer(text) if match[1] in texts)
            plain = _LINK.sub(lambda match: match[2] or match[1], text)
            self._articles[title] = Article(title, plain, tuple(links))
        self.titles = tuple(self._articles)

    def article(self, title: str) -> Article:
        """Return an article by its exact title.

        Raises:
            ArgumentError: There is none.
        """
        try:
            return self._articles[title]
        except KeyError:
            near = get_close_matches(title[:100], self.titles, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ArgumentError(f"there is no article {title!r:.100}.{hint}") from None

    def pair(self, draws: CheapRandom, nearest: int, farthest: int) -> Pair:
        """Draw a start, and a target whose shortest way from there has so many links.

        Raises:
            ArgumentError: There are no such two articles.
        """
        count = len(self.titles)
        first = draws.below(count) if count else 0
        for number in range(first, first + count):
            start = self.titles[number % count]
            distances = {start: 0}
            for title, previous in self._way_back(start).items():
                if title != start:
                    distances[title] = distances[previous] + 1
            targets = [(title, far) for title, far in distances.items() if nearest <= far <= farthest]
            if targets:
                target, distance = targets[draws.below(len(targets))]
                return Pair(start, target, distance)
        raise ArgumentError(f"no two articles are {nearest} to {farthest} links apart; lower min_distance")

    def way(self, start: str, target: str) -> list[str]:
        """Return the titles on a shortest way, both ends included.

        Raises:
            ArgumentError: One of the two does not exist, or no way leads to the target.
        """
        before = self._way_back(self.article(start).title)
        way = [self.article(target).title]
        while way[-1] != start:
            if way[-1] not in before:
                raise ArgumentError(f"no links lead from {start!r} to {target!r}")
            way.append(before[way[-1]])
        return way[::-1]

    def _way_back(self, start: str) -> dict[str, str]:
        """Return for each article the one before it on a shortest way from the start, in order of distance."""
        before = {start: start}
        reached = [start]
        for title in reached:  # it grows while it is read: the articles found last come last
            for link in self._articles[title].links:
                if link not in before:
                    before[link] = title
                    reached.append(link)
        return before


@lru_cache(maxsize=8)
def load_articles(path: str | None = None) -> Articles:
    """Return the articles of a file, read once; without one, those that are shipped here.

    Raises:
        ArgumentError: The file cannot be read, or holds something else.
    """
    file = files("gem_games.wiki").joinpath("articles.jsonl") if path is None else Path(path).expanduser()
    try:
        return Articles(file.read_text(encoding="utf-8").splitlines())
    except (OSError, ValueError) as error:
        raise ArgumentError(f"articles {path!r} cannot be read: {error}") from error
