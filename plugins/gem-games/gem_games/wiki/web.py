"""Fetching from a server with limits of time and size, and what all article graphs behind a server share."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from http.client import HTTPException
from typing import Any, NamedTuple
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import (
    HTTPDefaultErrorHandler,
    HTTPErrorProcessor,
    HTTPHandler,
    HTTPRedirectHandler,
    HTTPSHandler,
    OpenerDirector,
    ProxyHandler,
    Request,
    UnknownHandler,
)

from gem_core.errors import ArgumentError
from gem_games.wiki.graph import Article, ArticleError, ArticleGraph, ArticleNotFound

_MOST_BYTES = 20_000_000
_CHUNK_BYTES = 65_536
_KEPT_ARTICLES = 1_000
_BUSY = {429, 500, 502, 503, 504}
_ATTEMPTS = 3
_LONGEST_PAUSE_S = 10.0
_USER_AGENT = "gem-games WikiGame (a gym for language-model agents; urllib)"


class Answer(NamedTuple):
    """What a server answered.

    Args:
        url: Where it came from in the end, after redirects.
        text: The body.
    """

    url: str
    text: str


class WebArticles(ArticleGraph):
    """Articles behind a server; the last thousand are kept.

    Args:
        url: Address of the server, ``http`` or ``https``.
        timeout_s: How long the server may let one wait: for a connection, for the next data, for a whole answer.
        pause_s: Pause before a request to a busy server is tried a second time; the next one is twice as long. A
            server that names a time itself is waited for up to ten seconds.
    """

    advice = "see that it runs and that url is its address, or play with backend='embedded'"

    def __init__(self, url: str, timeout_s: float = 10.0, pause_s: float = 0.5) -> None:
        parts = urlsplit(url) if isinstance(url, str) else None
        if parts is None or parts.scheme not in ("http", "https") or not parts.hostname:
            raise ArgumentError(f"url must be an address such as 'http://localhost:8080', not {url!r}")
        if type(timeout_s) not in (int, float) or not 0 < timeout_s <= 3600:
            raise ArgumentError(f"timeout_s must be a number of seconds above 0 and up to 3600, not {timeout_s!r}")
        self.url = url.rstrip("/")
        self.timeout_s = timeout_s
        self.pause_s = pause_s
        self._opener = OpenerDirector()
        for handler in _handlers():
            self._opener.add_handler(handler)
        self._kept: OrderedDict[str, Article] = OrderedDict()
        self._lock = threading.Lock()

    def article(self, title: str) -> Article:
        """Return an article, from memory if it was fetched lately."""
        with self._lock:
            article = self._kept.get(title)
            if article is not None:
                self._kept.move_to_end(title)
                return article
        article = self._fetch(title)
        with self._lock:
            self._kept[title] = self._kept[article.title] = article
            while len(self._kept) > _KEPT_ARTICLES:
                self._kept.popitem(last=False)
        return article

    @abstractmethod
    def _fetch(self, title: str) -> Article:
        """Fetch an article from the server."""

    def _get(self, url: str) -> Answer:
        """Fetch what is at an address, again if the server is busy.

        Raises:
            ArticleNotFound: The server says that there is nothing.
            ArticleError: It failed, was too slow, or answered too much.
        """
        for attempt in range(1, _ATTEMPTS + 1):
            deadline = time.monotonic() + self.timeout_s
            try:
                return self._read(url, deadline)
            except HTTPError as error:
                with error:
                    if error.code in (404, 410):
                        raise ArticleNotFound(f"{self.url} has nothing at {url!r:.300}") from error
                    if error.code not in _BUSY or attempt == _ATTEMPTS:
                        raise self._failure(f"answered {error.code} {error.reason}") from error
                    pause = _retry_after(error, self.pause_s * 2 ** (attempt - 1))
                time.sleep(pause)
            except TimeoutError as error:
                raise self._failure(f"took longer than timeout_s={self.timeout_s:g}") from error
            except (OSError, HTTPException, ValueError) as error:
                reason = error.reason if isinstance(error, URLError) else error
                if isinstance(reason, TimeoutError):
                    raise self._failure(f"took longer than timeout_s={self.timeout_s:g}") from error
                raise self._failure(f"cannot be read ({reason or type(error).__name__})") from error
        raise self._failure("was busy")

    def _read(self, url: str, deadline: float) -> Answer:
        request = Request(url, headers={"User-Agent": _USER_AGENT})
        answer: Any = self._opener.open(request, timeout=self.timeout_s)
        with answer:
            chunks, size = [], 0
            # One read at a time: the socket's own limit holds for each of them, not for all.
            while chunk := answer.read1(_CHUNK_BYTES):
                chunks.append(chunk)
                size += len(chunk)
                if size > _MOST_BYTES:
                    raise self._failure(f"answered more than {_MOST_BYTES:,} bytes to one request")
                if time.monotonic() > deadline:
                    raise TimeoutError
            if answer.length:  # what was announced and never came; the client itself does not complain
                raise self._failure("hung up in the middle of an answer")
            charset = answer.headers.get_content_charset() or "utf-8"
            return Answer(answer.url, _decoded(b"".join(chunks), charset))

    def _failure(self, what: str) -> ArticleError:
        return ArticleError(f"the server of articles at {self.url} {what}; {self.advice}")


def _handlers() -> list[Any]:
    """Return handlers for http and https alone: no redirect leads to a file."""
    kinds: list[Callable[[], Any]] = [
        ProxyHandler,
        UnknownHandler,
        HTTPHandler,
        HTTPSHandler,
        HTTPDefaultErrorHandler,
        HTTPRedirectHandler,
        HTTPErrorProcessor,
    ]
    return [kind() for kind in kinds]


def _retry_after(error: HTTPError, pause_s: float) -> float:
    """Return the seconds that a busy server asks to wait, within bounds, or the given ones."""
    asked = error.headers.get("Retry-After", "")
    return min(float(asked), _LONGEST_PAUSE_S) if asked.isdecimal() and len(asked) < 10 else pause_s


def _decoded(body: bytes, charset: str) -> str:
    try:
        return body.decode(charset, "replace")
    except LookupError:
        return body.decode("utf-8", "replace")
