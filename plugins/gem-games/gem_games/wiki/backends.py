"""Which article graph a game asks for by name; games that ask for the same one share it, and what it has fetched."""

from __future__ import annotations

from functools import lru_cache

from gem_core.errors import ArgumentError
from gem_games.wiki.embedded import embedded_articles
from gem_games.wiki.graph import ArticleGraph

BACKENDS = "embedded", "kiwix", "mediawiki"


def article_graph(
    backend: str | ArticleGraph, url: str | None = None, book: str | None = None, timeout_s: float = 10.0
) -> ArticleGraph:
    """Return the article graph of a name, or the given one.

    Args:
        backend: One of ``BACKENDS``, or an article graph.
        url: Address of the server. None means ``http://localhost:8080`` for Kiwix.
        book: Book of the Kiwix server; see ``KiwixArticles``.
        timeout_s: Limit for one request to the server.

    Raises:
        ArgumentError: There is no such backend, or it does not take one of the arguments.
    """
    if not isinstance(backend, ArticleGraph) and backend not in BACKENDS:
        names = ", ".join(map(repr, BACKENDS))
        raise ArgumentError(f"backend must be one of {names}, or an ArticleGraph, not {backend!r}")
    if any(not isinstance(text, str | None) for text in (url, book)) or not isinstance(timeout_s, int | float):
        raise ArgumentError(f"url and book must be text and timeout_s a number, not {(url, book, timeout_s)!r:.200}")
    if book is not None and backend != "kiwix":
        raise ArgumentError("book goes with backend='kiwix' alone; leave it out")
    if backend == "kiwix" or backend == "mediawiki":
        return _server(backend, url, book, timeout_s)
    if url is not None:
        raise ArgumentError("url goes with backend='kiwix' or backend='mediawiki'; leave it out, or name one of them")
    return backend if isinstance(backend, ArticleGraph) else embedded_articles()


@lru_cache(maxsize=32)
def _server(backend: str, url: str | None, book: str | None, timeout_s: float) -> ArticleGraph:
    if backend == "kiwix":
        from gem_games.wiki.kiwix import KiwixArticles

        return KiwixArticles(url or "http://localhost:8080", book, timeout_s)
    if url is None:
        raise ArgumentError("backend='mediawiki' needs url, the address of the wiki's api.php")
    from gem_games.wiki.mediawiki import MediaWikiArticles

    return MediaWikiArticles(url, timeout_s)
