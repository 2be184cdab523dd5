"""The articles that are shipped here: general knowledge in a few sentences each, written for this project."""

from __future__ import annotations

import json
import re
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from typing import ClassVar

from gem_core.errors import ArgumentError
from gem_core.types import Concurrency
from gem_games.cheap_random import CheapRandom
from gem_games.wiki.graph import Article, ArticleGraph, ArticleNotFound, Pair

# [[Title]], or [[Title|other words]] where the sentence needs them.
_LINK = re.compile(r"\[\[([^\[\]|]+)(?:\|([^\[\]|]+))?\]\]")


class EmbeddedArticles(ArticleGraph):
    """Articles in memory, every one of which can be reached from every other.

    Args:
        lines: JSON lines of ``{"title": …, "text": …}``, the links of the text marked ``[[Title]]`` or
            ``[[Title|words]]``.
    """

    concurrency: ClassVar[Concurrency] = "inline"

    def __init__(self, lines: str) -> None:
        self._articles: dict[str, Article] = {}
        for line in lines.splitlines():
            record = json.loads(line)
            links = tuple(dict.fromkeys(match[1] for match in _LINK.finditer(record["text"])))
            text = _LINK.sub(lambda match: match[2] or match[1], record["text"])
            self._articles[record["title"]] = Article(record["title"], text, links)
        self.titles = tuple(self._articles)
        self._before: dict[str, dict[str, str]] = {}
        self._targets: dict[tuple[str, int, int], list[tuple[str, int]]] = {}

    def article(self, title: str) -> Article:
        """Return an article by its exact title."""
        try:
            return self._articles[title]
        except KeyError:
            near = get_close_matches(title[:100], self.titles, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ArticleNotFound(f"there is no embedded article {title!r:.100}.{hint}") from None

    def random_article(self, draws: CheapRandom) -> Article:
        """Draw any article, all being equally likely."""
        return self._articles[self.titles[draws.below(len(self.titles))]]

    def pair(self, draws: CheapRandom, nearest: int, farthest: int) -> Pair:
        """Draw a start, and a target whose shortest way from there has so many links.

        Raises:
            ArgumentError: There are no such two articles.
        """
        count = len(self.titles)
        first = draws.below(count)
        for number in range(first, first + count):
            start = self.titles[number % count]
            targets = self._targets_of(start, nearest, farthest)
            if targets:
                target, distance = targets[draws.below(len(targets))]
                return Pair(start, target, distance)
        raise ArgumentError(f"no two embedded articles are {nearest} to {farthest} links apart; lower min_distance")

    def way(self, start: str, target: str) -> list[str]:
        """Return the titles on a shortest way, both ends included.

        Raises:
            ArticleNotFound: One of the two does not exist, or no way leads to the target.
        """
        before = self._way_back(self.article(start).title)
        way = [self.article(target).title]
        while way[-1] != start:
            if way[-1] not in before:
                raise ArticleNotFound(f"no links lead from {start!r} to {target!r}")
            way.append(before[way[-1]])
        return way[::-1]

    def _way_back(self, start: str) -> dict[str, str]:
        """Return for each article the one before it on a shortest way from the start, in order of distance."""
        before = self._before.get(start)
        if before is None:
            before = {start: start}
            reached = [start]
            for title in reached:  # it grows while it is read: the articles found last come last
                for link in self._articles[title].links:
                    if link not in before:
                        before[link] = title
                        reached.append(link)
            self._before[start] = before
        return before

    def _targets_of(self, start: str, nearest: int, farthest: int) -> list[tuple[str, int]]:
        """Return the articles at so many links from the start, each with its distance."""
        key = start, nearest, farthest
        targets = self._targets.get(key)
        if targets is None:
            distances = {start: 0}
            for title, previous in self._way_back(start).items():
                if title != start:
                    distances[title] = distances[previous] + 1
            targets = [(title, far) for title, far in distances.items() if nearest <= far <= farthest]
            self._targets[key] = targets
        return targets


@lru_cache(maxsize=1)
def embedded_articles() -> EmbeddedArticles:
    """Return the articles that are shipped here, read when they are first asked for."""
    return EmbeddedArticles(files("gem_games.wiki").joinpath("articles.jsonl").read_text(encoding="utf-8"))
