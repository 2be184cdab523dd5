"""Searching on a server over aiohttp: requests, answers, retries, a deadline, and no trace of the key.

Two forms are known: that of Search-R1's retrieval server, which others have taken over, and Serper's, a search engine
of the web. The key is read from the environment for each request; no attribute, message or record holds it. Answers
come from outside: parts of another form are left out.

Sources: ``retrieval_server.py`` of PeterGriffinJin/Search-R1; the API page of serper.dev.
"""

from __future__ import annotations

import asyncio
import functools
import json
import os
import random
import urllib.parse
import urllib.request
import weakref
from collections.abc import Mapping
from typing import Any

import aiohttp
import tenacity

from gem_core.background import background_loop, close_later, on_library_loop
from gem_core.errors import ArgumentError, GemError, MissingRequirementError
from gem_tools.search.corpus import split_contents
from gem_tools.search.passages import Passage, one_line, printable

RETRIEVE, SERPER = "retrieve", "serper"

MAX_ANSWER_BYTES = 8_000_000
MAX_TEXT_CHARS = 100_000
"""Longer passages of a server are cut."""

_CONNECT_TIMEOUT_S = 5.0
_FIRST_WAIT_S = 0.5
_GROWING_WAIT_S = tenacity.wait_exponential(multiplier=_FIRST_WAIT_S, max=30.0)
_KEEP_ALIVE_S = 4.0  # below the 5 s of uvicorn and others, which close a connection while we begin to write
_SERPER_URL, _SERPER_KEY = "https://google.serper.dev/search", "SERPER_API_KEY"


class SearchFault(Exception):
    """A search that brought no answer.

    Args:
        message: What went wrong, in one line and without the key.
        transient: Whether to try again.
        retry_after: Seconds that the server asks to wait.
    """

    def __init__(self, message: str, *, transient: bool = True, retry_after: float | None = None) -> None:
        super().__init__(message)
        self.transient = transient
        self.retry_after = retry_after


# Requests and answers.


def api_key() -> str:
    """Return the key of the web engine.

    Raises:
        MissingRequirementError: It is not set.
        ArgumentError: No HTTP header can hold it.
    """
    key = os.environ.get(_SERPER_KEY, "").strip()
    if not key:
        raise MissingRequirementError(
            f"the search engine 'serper' needs a key: set the environment variable {_SERPER_KEY}"
        )
    if not (key.isascii() and key.isprintable()):
        raise ArgumentError(f"the key in {_SERPER_KEY} has characters that no key has; set it again")
    return key


def read_retrieved(answer: Any) -> list[Passage]:
    """Return the passages of an answer in Search-R1's form."""
    if not isinstance(answer, dict) or not isinstance(answer.get("result"), list):
        raise SearchFault("the answer has no list under 'result'", transient=False)
    rows = answer["result"]
    # One list for each query; some servers leave out the outer one.
    items = rows[0] if rows and isinstance(rows[0], list) else rows
    passages = []
    for item in items:
        document = item.get("document", item) if isinstance(item, dict) else {"contents": item}
        document = document if isinstance(document, dict) else {"contents": document}
        title, text = _text(document, "title"), _text(document, "text")
        if not text:
            first, text = split_contents(_text(document, "contents"))
            title = title or first
        name = document.get("id")
        name = str(name) if isinstance(name, int) else _text(document, "id")
        score = item.get("score") if isinstance(item, dict) else None
        # An int may be too large for a float, and what is not finite is no JSON.
        score = float(score) if isinstance(score, int | float) and abs(score) < 1e300 else None
        if text or title:
            passages.append(Passage(name, title, text, score))
    return passages


def read_serper(answer: Any) -> list[Passage]:
    """Return the results of a web search, after the box with an answer if there is one."""
    if not isinstance(answer, dict):
        raise SearchFault(f"the answer is a {type(answer).__name__}, not an object", transient=False)
    box, organic = answer.get("answerBox"), answer.get("organic")
    return [
        Passage("", _text(row, "title"), text, None, _text(row, "link"))
        for row in [box, *(organic if isinstance(organic, list) else [])]
        if isinstance(row, dict) and (text := _text(row, "answer") or _text(row, "snippet") or _text(row, "title"))
    ]


def _text(row: Mapping[str, Any], name: str) -> str:
    value = row.get(name)
    return printable(value[:MAX_TEXT_CHARS]) if isinstance(value, str) else ""


# The server.


class SearchServer:
    """A server, for any number of tools.

    Args:
        engine: ``"retrieve"`` or ``"serper"``.
        url: Its address; empty for the engine's own.
        timeout_s: Limit of a search, in seconds, all attempts included.
        max_retries: Attempts after the first.
        max_concurrency: Requests at once.

    Raises:
        ArgumentError: An address or limit that cannot be right.
        MissingRequirementError: There is no key for the web engine.
    """

    def __init__(self, engine: str, url: str, timeout_s: float, max_retries: int, max_concurrency: int) -> None:
        for option, value, least in (("max_retries", max_retries, 0), ("max_concurrency", max_concurrency, 1)):
            if type(value) is not int or value < least:
                raise ArgumentError(f"{option} must be a whole number from {least} up, not {value!r}")
        if isinstance(timeout_s, bool) or not isinstance(timeout_s, int | float) or not 0 < timeout_s < float("inf"):
            raise ArgumentError(f"timeout_s must be a positive number, not {timeout_s!r}")
        if engine == SERPER:
            api_key()
            url = url or _SERPER_URL
        self.engine, self.url = engine, _checked_address(engine, url)
        self.timeout_s, self.max_retries, self.max_concurrency = timeout_s, max_retries, max_concurrency
        self.sleep = asyncio.sleep
        self._link: tuple[asyncio.AbstractEventLoop, aiohttp.ClientSession] | None = None

    async def search(self, query: str, top_k: int) -> list[Passage]:
        """Return the passages.

        Raises:
            SearchFault: No attempt brought an answer.
        """
        return await on_library_loop(self._with_retries(query, top_k))

    async def _with_retries(self, query: str, top_k: int) -> list[Passage]:
        retrying = tenacity.AsyncRetrying(
            retry=tenacity.retry_if_exception(lambda error: isinstance(error, SearchFault) and error.transient),
            wait=_wait_s,
            stop=tenacity.stop_after_attempt(1 + self.max_retries) | tenacity.stop_before_delay(self.timeout_s),
            sleep=self.sleep,
            reraise=True,
        )
        try:
            async with asyncio.timeout(self.timeout_s):
                passages: list[Passage] = await retrying(self._attempt, query, top_k)
                return passages
        except TimeoutError:
            raise SearchFault("no answer in time") from None
        except SearchFault as fault:
            attempts = retrying.statistics["attempt_number"]
            if attempts > 1:
                raise SearchFault(f"{fault} ({attempts} attempts)") from None
            raise

    async def _attempt(self, query: str, top_k: int) -> list[Passage]:
        try:
            return await self._exchange(query, top_k)
        except GemError as error:  # the key is not there any more
            fault = SearchFault(str(error), transient=False)
        except (aiohttp.ClientError, OSError, ValueError) as error:
            fault = _fault(error)
        raise fault  # outside of the clauses: aiohttp's error would be its context, and name the address

    async def _exchange(self, query: str, top_k: int) -> list[Passage]:
        web = self.engine == SERPER
        key = api_key() if web else ""
        # Without scores, servers of Search-R1's form answer with status 500.
        body = {"q": query, "num": top_k} if web else {"queries": [query], "topk": top_k, "return_scores": True}
        async with self._session().post(
            self.url,
            json=body,
            headers={"X-API-KEY": key} if web else {},
            allow_redirects=False,  # which would take the key elsewhere, and make a GET of a POST
            proxy=proxy_for(self.url),
        ) as response:
            answer = bytearray()
            async for piece in response.content.iter_any():
                answer += piece
                if len(answer) > MAX_ANSWER_BYTES:
                    raise SearchFault(f"the answer is longer than {MAX_ANSWER_BYTES // 1_000_000} MB", transient=False)
        text = answer.decode("utf-8-sig", "replace")
        for form in (key, urllib.parse.quote(key), urllib.parse.quote_plus(key)) if key else ():
            text = text.replace(form, "***")
        if response.status != 200:
            raise _refusal(response, text)
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            raise SearchFault("the answer is no JSON") from None
        return (read_serper(found) if web else read_retrieved(found))[:top_k]

    def _session(self) -> aiohttp.ClientSession:
        loop = background_loop()
        if self._link is None or self._link[0] is not loop:  # the first search, or the first after a fork
            session = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=self.max_concurrency, keepalive_timeout=_KEEP_ALIVE_S),
                timeout=aiohttp.ClientTimeout(total=None, sock_connect=_CONNECT_TIMEOUT_S),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": "gem-tools"},
            )
            self._link = loop, session
            weakref.finalize(self, close_later, session, loop)
        return self._link[1]


shared_server = functools.cache(SearchServer)
"""Tools with the same settings share the connections of a process."""


def _checked_address(engine: str, address: str) -> str:
    try:
        parts = urllib.parse.urlsplit(address)
        if parts.scheme in ("http", "https") and parts.hostname and parts.port != 0:
            no_path = engine == RETRIEVE and parts.path in ("", "/")
            return parts._replace(path="/retrieve").geturl() if no_path else address
    except ValueError:
        pass
    # Not shown: an address may hold a password.
    raise ArgumentError(f"the address of the engine {engine!r} must look like 'http://localhost:8000/retrieve'")


def _wait_s(state: tenacity.RetryCallState) -> float:
    """Return how long to wait for the next attempt: at random, so that not all come back in one instant.

    Source: "full jitter", https://aws.amazon.com/blogs/architecture/exponential-backoff-and-jitter/.
    """
    fault = state.outcome.exception() if state.outcome else None
    # A generator of its own: tenacity's jitter would move the caller's seeded stream.
    chance = random.Random().uniform
    if isinstance(fault, SearchFault) and fault.retry_after is not None:
        return fault.retry_after + chance(0.0, _FIRST_WAIT_S)
    return chance(0.0, _GROWING_WAIT_S(state))


def _refusal(response: aiohttp.ClientResponse, text: str) -> SearchFault:
    message = text[:2000]
    try:
        said = json.loads(text)
        while isinstance(said, dict):
            said = next((said[name] for name in ("message", "error", "detail") if said.get(name)), None)
        message = said if isinstance(said, str) else message
    except (ValueError, RecursionError):
        pass
    if 300 <= response.status < 400:
        message = "it redirects elsewhere"
    seconds = response.headers.get("Retry-After", "")
    retry_after = float(seconds) if seconds.isdecimal() else None
    asks = "" if retry_after is None else f", and it asks to wait {retry_after:.0f} s"
    return SearchFault(
        f"status {response.status}: {one_line(message or response.reason or 'no reason given')}{asks}",
        transient=response.status in (408, 409, 425, 429) or (response.status >= 500 and response.status != 501),
        retry_after=retry_after,
    )


def _fault(error: Exception) -> SearchFault:
    """Return a fault in words of our own: aiohttp's may hold the address, and so a password."""
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return SearchFault("its certificate is not accepted", transient=False)
    if isinstance(error, aiohttp.ClientConnectorDNSError):
        return SearchFault("there is no host of this name")
    if isinstance(error, aiohttp.ClientConnectorError) and error.os_error.errno:
        return SearchFault(f"no connection ({os.strerror(error.os_error.errno).lower()})")
    return SearchFault(f"the connection broke ({type(error).__name__})")


def proxy_for(url: str) -> str | None:
    """Return the proxy that the environment names; none for this machine itself.

    aiohttp's own ``trust_env`` also sends the passwords of ``~/.netrc``, and raises if a key is sent as well.
    """
    parts = urllib.parse.urlsplit(url)
    host = parts.hostname or ""
    if host in ("localhost", "127.0.0.1", "::1") or urllib.request.proxy_bypass(host):
        return None
    return urllib.request.getproxies().get(parts.scheme)
