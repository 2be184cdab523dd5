"""Articles of a MediaWiki, such as Wikipedia, through its API."""

from __future__ import annotations

import json
from string import ascii_lowercase, ascii_uppercase
from typing import Any
from urllib.parse import urlencode

from gem_games.cheap_random import CheapRandom
from gem_games.wiki.graph import Article, ArticleNotFound
from gem_games.wiki.html import PageReader
from gem_games.wiki.web import WebArticles

_LISTED = 50
_DRAWS = 10
_MOST_LINKS = 2_000
_MOST_BATCHES = 100
_LONGEST_TEXT = 10_000


class MediaWikiArticles(WebArticles):
    """The articles of a wiki.

    Links are those to existing articles, under the titles that redirects lead to, in alphabetical order; at most about
    two thousand for one article. Pages that only tell meanings of a word apart are left out. A start is drawn from
    the titles that follow three random letters in the wiki's own order: unlike the wiki's own draw, that depends on
    nothing but the seed and the wiki.

    Args:
        url: Address of the API, such as ``https://en.wikipedia.org/w/api.php``. Mind the rules of the wiki.
        timeout_s: See ``WebArticles``.
        pause_s: See ``WebArticles``.

    Source: https://www.mediawiki.org/wiki/API:Query.
    """

    advice = "give the address of its api.php as url, or play with backend='embedded'"

    def random_article(self, draws: CheapRandom) -> Article:
        """Draw an article that has links."""
        for _ in range(_DRAWS):
            letters = [ascii_uppercase, ascii_lowercase, ascii_lowercase]
            first = "".join(letter[draws.below(26)] for letter in letters)
            titles = self._titles_from(first) or self._titles_from("")
            if not titles:
                break
            try:
                article = self.article(titles[draws.below(len(titles))])
            except ArticleNotFound:  # a page that only tells meanings apart
                continue
            if article.links:
                return article
        raise self._failure("has no article with links")

    def _titles_from(self, first: str) -> list[str]:
        query = {"list": "allpages", "apnamespace": 0, "apfilterredir": "nonredirects", "aplimit": _LISTED}
        found = self._ask(query | ({"apfrom": first} if first else {}))
        return [str(page["title"]) for page in _records(found, "allpages")]

    def _fetch(self, title: str) -> Article:
        if "|" in title:
            raise ArticleNotFound(f"{title!r:.200} is no title: the API would take it for several")
        found = self._ask(
            {
                "prop": "extracts|pageprops",
                "titles": title,
                "redirects": 1,
                "exintro": 1,
                "explaintext": 1,
                "ppprop": "disambiguation",
            }
        )
        pages = _records(found, "pages")
        if not pages or "missing" in pages[0] or "invalid" in pages[0] or "title" not in pages[0]:
            raise ArticleNotFound(f"the wiki at {self.url} has no article {title!r:.200}")
        if "disambiguation" in (pages[0].get("pageprops") or {}):
            raise ArticleNotFound(f"{title!r:.200} only tells meanings apart in the wiki at {self.url}")
        own = str(pages[0]["title"])
        text = pages[0].get("extract")
        if not isinstance(text, str):  # the wiki lacks the extension TextExtracts
            text = self._parsed(own)
        return Article(own, text[:_LONGEST_TEXT].strip(), self._links_of(own))

    def _links_of(self, title: str) -> tuple[str, ...]:
        query = {
            "generator": "links",
            "gplnamespace": 0,
            "gpllimit": "max",
            "titles": title,
            "redirects": 1,
            "prop": "pageprops",
            "ppprop": "disambiguation",
        }
        titles: set[str] = set()
        unclear = {title}
        more: dict[str, Any] = {}
        for _ in range(_MOST_BATCHES):
            found = self._ask(query | more)
            for page in _records(found, "pages"):
                if "disambiguation" in (page.get("pageprops") or {}):
                    unclear.add(str(page.get("title")))
                elif page.get("ns") == 0 and "missing" not in page and "title" in page:
                    titles.add(str(page["title"]))
            more = found.get("continue") or {}
            if not isinstance(more, dict) or not more or len(titles) >= _MOST_LINKS:
                break
        return tuple(sorted(titles - unclear)[:_MOST_LINKS])

    def _parsed(self, title: str) -> str:
        asked = {"action": "parse", "page": title, "prop": "text", "section": 0, "redirects": 1}
        parsed = self._ask(asked).get("parse")
        page = parsed.get("text") if isinstance(parsed, dict) else None
        return PageReader(page if isinstance(page, str) else "").text

    def _ask(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """Return what the API answers to a request.

        Raises:
            ArticleError: It reports an error, or answers something else.
        """
        query = {"action": "query", "format": "json", "formatversion": 2} | parameters
        body = self._get(f"{self.url}?{urlencode(query, errors='replace')}").text
        try:
            answer = json.loads(body)
        except (ValueError, RecursionError) as error:
            raise self._failure("does not answer in JSON") from error
        if not isinstance(answer, dict) or "error" in answer:
            fault = answer.get("error") if isinstance(answer, dict) else None
            told = fault.get("info") or fault.get("code") if isinstance(fault, dict) else "no object"
            raise self._failure(f"refuses the request: {told!s:.300}")
        return answer


def _records(answer: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the list of a query's answer that has this name, empty where there is none."""
    query = answer.get("query")
    found = query.get(name) if isinstance(query, dict) else None
    return [record for record in found if isinstance(record, dict)] if isinstance(found, list) else []
