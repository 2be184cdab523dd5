"""Articles of a ZIM file behind ``kiwix-serve``, read from its HTML pages."""

from __future__ import annotations

import json
import re
from html import unescape
from string import ascii_lowercase
from urllib.parse import quote, unquote, urldefrag, urlencode, urljoin, urlsplit

from gem_core.errors import ArgumentError
from gem_games.cheap_random import CheapRandom
from gem_games.wiki.graph import Article, ArticleError, ArticleNotFound
from gem_games.wiki.html import PageReader
from gem_games.wiki.web import Answer, WebArticles

_MOST_REFRESHES = 5
_SUGGESTIONS = 50
_PREFIXES = 10
_APART = "(disambiguation)"
_BOOK_LINK = re.compile(r'<link\b[^>]*\btype="text/html"[^>]*>', re.IGNORECASE)
_HREF = re.compile(r'\bhref="([^"]*)"')
# Pages about the collection rather than of it, and files.
_NO_ARTICLE = re.compile(
    r"(?:category|file|help|image|media|mediawiki|module|portal|special|talk|template|user|wikipedia|wikt):"
    r"|.*\.(?:css|gif|jpe?g|js|json|ogg|ogv|pdf|png|svg|webm|webp)$|_[a-z]+_/",
    re.IGNORECASE,
)


class KiwixArticles(WebArticles):
    """The articles of one book of a Kiwix server.

    A start is drawn from what the server suggests for a random pair of Latin letters, so that a seed gives the same
    one as long as the book is the same. If it never suggests anything, as for a book in another script, the server
    itself draws, and then a seed does not decide the pair.

    Args:
        url: Address of the server, with its root location if it has one.
        book: Name of the book as in its addresses, usually the file's name without ``.zim``. None takes the only one.
        timeout_s: See ``WebArticles``.
        pause_s: See ``WebArticles``.

    Source: the addresses of kiwix-serve 3.4 and later, https://kiwix-tools.readthedocs.io/.
    """

    advice = "start one with 'kiwix-serve --port 8080 FILE.zim' and give its url, or play with backend='embedded'"

    def __init__(
        self,
        url: str = "http://localhost:8080",
        book: str | None = None,
        timeout_s: float = 10.0,
        pause_s: float = 0.5,
    ) -> None:
        super().__init__(url, timeout_s, pause_s)
        if book is not None and not (isinstance(book, str) and book.strip("/ ")):
            raise ArgumentError(f"book must be the name of a book of the Kiwix server, not {book!r}")
        self._book = book
        self._root: str | None = None

    def random_article(self, draws: CheapRandom) -> Article:
        """Draw an article that has links."""
        for _ in range(_PREFIXES):
            prefix = "".join(ascii_lowercase[draws.below(26)] for _ in range(2))
            titles = self._suggested(prefix)
            if titles:
                title = titles[draws.below(len(titles))]
                article = self._playable(title)
                if article is not None:
                    return article
        for _ in range(_PREFIXES):
            answer = self._get(f"{self.url}/random?{urlencode({'content': self._book_name()})}")
            drawn = self._title_at(answer.url)
            article = self._playable(drawn) if drawn else None
            if article is not None:
                return article
        raise self._failure(f"has no article with links in the book {self._book_name()!r}")

    def _playable(self, title: str) -> Article | None:
        try:
            article = self.article(title)
        except ArticleNotFound:
            return None
        return article if article.links and _APART not in article.title else None

    def _suggested(self, prefix: str) -> list[str]:
        query = urlencode({"content": self._book_name(), "term": prefix, "count": _SUGGESTIONS})
        found = self._get(f"{self.url}/suggest?{query}").text
        try:
            entries = json.loads(found)
            if not isinstance(entries, list):
                raise TypeError("no list")
            # The server escapes twice, for HTML and for JSON.
            paths = [unescape(entry["path"]) for entry in entries if entry["kind"] == "path"]
        except (ValueError, TypeError, LookupError, RecursionError) as error:
            raise self._failure(f"gave suggestions that cannot be read ({error})") from error
        titles = (self._title_at(urljoin(self._content(), quote(path))) for path in paths)
        return [title for title in dict.fromkeys(titles) if title]

    def _fetch(self, title: str) -> Article:
        answer = self._page(title)
        reader = PageReader(answer.text)
        for _ in range(_MOST_REFRESHES):
            if not reader.refresh:
                break
            answer = self._get(urljoin(answer.url, reader.refresh))
            reader = PageReader(answer.text)
        own = self._title_at(answer.url)
        if own is None:
            raise ArticleNotFound(f"{title!r:.200} leads out of the book {self._book_name()!r} of {self.url}")
        titles = dict.fromkeys(self._title_at(_joined(answer.url, href)) for href in reader.links)
        return Article(own, reader.text, tuple(link for link in titles if link and link != own and _APART not in link))

    def _page(self, title: str) -> Answer:
        path = quote(title.replace(" ", "_"), safe="/", errors="replace")
        return self._get(self._content() + path)

    def _content(self) -> str:
        """Return the address under which the articles lie: books of before 2021 keep them below ``A/``."""
        if self._root is None:
            root = f"{self.url}/content/{quote(self._book_name())}/"
            try:
                main = self._get(root).url
            except ArticleNotFound as error:
                raise ArticleError(
                    f"the Kiwix server at {self.url} has no book {self._book_name()!r}; see {self.url} for those it has"
                ) from error
            self._root = f"{root}A/" if main.startswith(f"{root}A/") else root
        return self._root

    def _book_name(self) -> str:
        """Return the name of the book, asking the server's catalogue for it if none was given."""
        if self._book is None:
            catalogue = self._get(f"{self.url}/catalog/v2/entries?count=-1").text
            addresses = (_HREF.search(link[0]) for link in _BOOK_LINK.finditer(catalogue))
            books = [unquote(found[1].rstrip("/").rpartition("/")[2]) for found in addresses if found]
            if len(books) != 1:
                names = ", ".join(sorted(books)[:10]) or "none"
                raise ArticleError(f"the Kiwix server at {self.url} has {len(books)} books; give one as book: {names}")
            self._book = books[0]
        return self._book

    def _title_at(self, url: str) -> str | None:
        """Return the title of the article at an address; None if it is none of this book."""
        path, root = unquote(urlsplit(url).path), unquote(urlsplit(self._content()).path)
        if not path.startswith(root) or urlsplit(url).netloc != urlsplit(self.url).netloc:
            return None
        title = path[len(root) :].replace("_", " ").strip()
        # A line break in a title could pass for a line of the game's own.
        return None if not title.isprintable() or _NO_ARTICLE.match(path[len(root) :]) else title or None


def _joined(base: str, href: str) -> str:
    try:
        return urldefrag(urljoin(base, href)).url
    except ValueError:  # an address such as "http://[" that no browser could open either
        return ""
