"""Asking a server: with retries, a deadline, a cache, a rate limit, and no trace of the key.

On aiohttp, as gem-openai's client, for its price; and since ``gem serve-search`` needs a server too. The key is read
from the environment for each request; no attribute, message or record holds it.
"""

from __future__ import annotations

import asyncio
import email.utils
import json
import math
import os
import random
import re
import time
import urllib.parse
import urllib.request
import weakref
from collections import OrderedDict
from typing import TYPE_CHECKING, NamedTuple

import tenacity

from gem_core.background import background_loop, close_later, in_thread, on_library_loop
from gem_core.errors import ArgumentError, GemError, MissingRequirementError
from gem_tools.search.passages import Passage, printable
from gem_tools.search.services import AnswerError, Service

if TYPE_CHECKING:
    from aiohttp import ClientResponse, ClientSession

    from gem_tools.search.disk_cache import DiskCache

MAX_ANSWER_BYTES = 8_000_000
MAX_TEXT_CHARS = 100_000
"""Of one passage; the rest is not kept."""

CONNECT_TIMEOUT_S = 5.0
LONGEST_PAUSE_S = 60.0

_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 30.0
_GROWING_WAIT_S = tenacity.wait_exponential(multiplier=_FIRST_WAIT_S, max=_LONGEST_WAIT_S)
_KEEP_ALIVE_S = 4.0  # below the 5 s of uvicorn and others, which close a connection while we begin to write
_SHOWN = 200
_SECRET = 4
"""What is shorter is no secret, and blotted out it would garble words."""


class SearchFault(Exception):
    """A search that brought no answer.

    Args:
        message: What went wrong, in one line and without the key.
        transient: Whether the same request may be answered later.
        retry_after: Seconds that the server asks to wait.
    """

    def __init__(self, message: str, *, transient: bool = True, retry_after: float | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.transient = transient
        self.retry_after = retry_after


class Limits(NamedTuple):
    """How a server is treated.

    Args:
        timeout_s: Limit of one search, all attempts and waits included.
        max_retries: Attempts after the first.
        max_concurrency: Requests at once.
        requests_per_s: Most requests in a second, attempts counted; None for no limit.
        cache_size: Searches whose results are kept; 0 for none.
    """

    timeout_s: float = 20.0
    max_retries: int = 3
    max_concurrency: int = 64
    requests_per_s: float | None = None
    cache_size: int = 10_000


class Found(NamedTuple):
    """The passages of a search, and whether they came from the cache."""

    passages: tuple[Passage, ...]
    cached: bool


class _Link(NamedTuple):
    """What belongs to one event loop."""

    loop: asyncio.AbstractEventLoop
    session: ClientSession
    places: asyncio.Semaphore
    proxy: str | None
    flying: dict[tuple[str, int], asyncio.Task[Found | SearchFault]]


class RemoteEngine:
    """Searches on one server, for any number of tools.

    Args:
        service: What the server speaks.
        url: Where it is.
        limits: How it is treated.
        disk: What was found is kept there as well; None for memory alone.

    ``now``, ``sleep`` and ``jitter`` (a random number between two) are what limits and waits go by.
    """

    def __init__(self, service: Service, url: str, limits: Limits, disk: DiskCache | None = None) -> None:
        self.service = service
        self.url = url
        self.limits = limits
        self.disk = disk
        self.now = time.monotonic
        self.sleep = asyncio.sleep
        # A generator of its own: jitter must differ between processes and touch nobody's random state.
        self.jitter = random.Random().uniform
        self._cache: OrderedDict[tuple[str, int], Found] = OrderedDict()
        self._link: _Link | None = None
        self._next_request = self._quiet_until = 0.0

    def __repr__(self) -> str:
        return f"RemoteEngine({self.service.name!r}, {self.where!r})"

    @property
    def where(self) -> str:
        """Scheme and host of the server: an address may hold a password."""
        parts = urllib.parse.urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"

    async def search(self, query: str, top_k: int) -> Found:
        """Return what the server finds; a search that is under way already is not sent again.

        Raises:
            SearchFault: No attempt brought an answer.
        """
        outcome = await on_library_loop(self._searched((query, top_k)))
        if isinstance(outcome, SearchFault):
            raise outcome from None
        return outcome

    async def aclose(self) -> None:
        """Close the connections; the next search opens new ones."""
        await on_library_loop(self._close())

    async def _close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.session.close()

    async def _searched(self, asked: tuple[str, int]) -> Found | SearchFault:
        if asked in self._cache:
            self._cache.move_to_end(asked)
            return self._cache[asked]._replace(cached=True)
        link = self._linked()
        task = link.flying.get(asked)
        if task is None:
            task = link.flying[asked] = link.loop.create_task(self._fetched(link, asked))
            task.add_done_callback(lambda _: link.flying.pop(asked, None))
        # Whoever gives up does so for itself; others may wait for the same.
        return await asyncio.shield(task)

    async def _fetched(self, link: _Link, asked: tuple[str, int]) -> Found | SearchFault:
        """Return the outcome as a value, so that no chain of exceptions drags along what was sent."""
        if self.disk is not None:
            # In a thread, since another process may hold the file for a moment.
            kept = await in_thread(self.disk.get, self._server, *asked)
            if kept is not None:
                return self._kept(asked, Found(kept, cached=True))
        end = self.now() + self.limits.timeout_s
        try:
            async with asyncio.timeout(self.limits.timeout_s):
                await link.places.acquire()
        except TimeoutError:
            return SearchFault("too many searches are under way; none was free in time")
        try:
            found = await self._with_retries(link, asked, end)
        except SearchFault as fault:
            return fault.with_traceback(None)
        finally:
            link.places.release()
        if self.disk is not None:
            await in_thread(self.disk.put, self._server, *asked, found.passages)
        return self._kept(asked, found)

    @property
    def _server(self) -> str:
        return f"{self.service.name} {self.url}"

    def _kept(self, asked: tuple[str, int], found: Found) -> Found:
        """Keep what was found in memory, and return it."""
        if self.limits.cache_size:
            self._cache[asked] = found
            while len(self._cache) > self.limits.cache_size:
                self._cache.popitem(last=False)
        return found

    async def _with_retries(self, link: _Link, asked: tuple[str, int], end: float) -> Found:
        def may_pass(error: BaseException) -> bool:
            return isinstance(error, SearchFault) and error.transient

        retrying = tenacity.AsyncRetrying(
            retry=tenacity.retry_if_exception(may_pass),
            wait=self._wait_s,
            stop=tenacity.stop_after_attempt(1 + self.limits.max_retries)
            | tenacity.stop_before_delay(end - self.now()),
            sleep=self.sleep,
            reraise=True,
        )
        try:
            found: Found = await retrying(self._attempt, link, asked, end)
            return found
        except SearchFault as fault:
            attempts = retrying.statistics["attempt_number"]
            if fault.retry_after is not None and may_pass(fault) and attempts <= self.limits.max_retries:
                fault.message += f", and it asks to wait {fault.retry_after:.0f} s"
            fault.message += f" ({attempts} attempts)" if attempts > 1 else ""
            raise

    def _wait_s(self, state: tenacity.RetryCallState) -> float:
        """Return how long to wait for the next attempt: at random, so that not all come back in one instant.

        Source: "full jitter", https://aws.amazon.com/blogs/architecture/exponential-backoff-and-jitter/.
        """
        fault = state.outcome.exception() if state.outcome else None
        if isinstance(fault, SearchFault) and fault.retry_after is not None:
            return fault.retry_after + self.jitter(0.0, _FIRST_WAIT_S)
        return self.jitter(0.0, _GROWING_WAIT_S(state))

    async def _attempt(self, link: _Link, asked: tuple[str, int], end: float) -> Found:
        from aiohttp import ClientError

        await self._take_turn(end)
        left = end - self.now()
        if left <= 0:
            raise SearchFault("the time for this search is up", transient=False)
        try:
            async with asyncio.timeout(left):
                return await self._once(link, asked)
        except SearchFault as error:
            fault = error
        except GemError as error:  # the key is not there any more
            fault = SearchFault(str(error), transient=False)
        except (ClientError, OSError, ValueError) as error:
            fault = _fault(error)
        if fault.retry_after is not None:
            # What one request is told holds for all, within reason.
            self._quiet_until = max(self._quiet_until, self.now() + min(fault.retry_after, LONGEST_PAUSE_S))
        raise fault  # outside of the clauses: aiohttp's error would go along, whose frames hold what was sent

    async def _take_turn(self, end: float) -> None:
        """Wait for the rate limit, and for the end of the pause that the server asked for."""
        now = self.now()
        start = max(now, self._quiet_until)
        if start >= end:
            raise SearchFault(f"it asks to wait {start - now:.0f} s before the next search", transient=False)
        if self.limits.requests_per_s is not None:
            start = max(start, self._next_request)
            if start >= end:
                raise SearchFault("the rate limit leaves no room for this search in time", transient=False)
            self._next_request = start + 1.0 / self.limits.requests_per_s
        if start > now:
            await self.sleep(start - now)

    async def _once(self, link: _Link, asked: tuple[str, int]) -> Found:
        query, top_k = asked
        sent = self.service.request(query, top_k, self.key())
        # A redirect would take the key elsewhere, and make a GET of a POST.
        async with link.session.request(
            sent.method,
            self.url,
            params=sent.params,
            headers=sent.headers,
            json=sent.body,
            allow_redirects=False,
            proxy=link.proxy,
        ) as response:
            body = await _body(response)
            if response.status != 200:
                raise self._refusal(response, body)
        try:
            passages = self.service.read(json.loads(body))
        except AnswerError as error:
            raise SearchFault(self.shown(str(error)), transient=False) from None
        except (ValueError, RecursionError):
            raise SearchFault("the answer is no JSON") from None
        return Found(tuple(map(self._bare, passages[:top_k])), cached=False)

    def _refusal(self, response: ClientResponse, body: bytes) -> SearchFault:
        message = body[:2000].decode("utf-8", "replace")
        try:
            said = json.loads(body)
            while isinstance(said, dict):
                said = next((said[name] for name in ("message", "error", "detail") if said.get(name)), None)
            message = said if isinstance(said, str) else message
        except (ValueError, RecursionError):
            pass
        if 300 <= response.status < 400:
            message = "it redirects elsewhere"
        return SearchFault(
            f"status {response.status}: {self.shown(message or response.reason or 'no reason given')}",
            transient=_is_transient(response.status),
            retry_after=_retry_after_s(response.headers.get("Retry-After")),
        )

    # The key.

    def key(self) -> str:
        """Return the key; nothing where the service needs none.

        Raises:
            MissingRequirementError: It is not set.
            ArgumentError: No HTTP header can hold it.
        """
        name = self.service.key_name
        if not name:
            return ""
        key = os.environ.get(name, "").strip()
        if not key:
            raise MissingRequirementError(
                f"the search engine {self.service.name!r} needs a key: set the environment variable {name}"
            )
        if not (key.isascii() and key.isprintable()):
            raise ArgumentError(f"the key in {name} has characters that no key has; set it again")
        return key

    def shown(self, text: str) -> str:
        """Return what a server said, fit to be shown: one line, not long, and without the key."""
        line = " ".join(printable(self._without_key(text)).split())
        return line if len(line) <= _SHOWN else f"{line[:_SHOWN]}…"

    def _without_key(self, text: str) -> str:
        key = os.environ.get(self.service.key_name, "").strip() if self.service.key_name else ""
        if len(key) < _SECRET:
            return text
        in_address = {urllib.parse.quote(key, safe=safe) for safe in ("", "/", "/+=")}
        for form in {key, *in_address, json.dumps(key)[1:-1]}:
            text = text.replace(form, "***")
        return text

    def _bare(self, passage: Passage) -> Passage:
        fields = (passage.id, passage.title, passage.text[:MAX_TEXT_CHARS], passage.url)
        name, title, text, url = (printable(self._without_key(field)) for field in fields)
        return Passage(name, title, text, passage.score, url)

    def _linked(self) -> _Link:
        loop = background_loop()  # another one after a fork
        if self._link is None or self._link.loop is not loop:
            import aiohttp

            session = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=0, keepalive_timeout=_KEEP_ALIVE_S),
                timeout=aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_TIMEOUT_S),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": "gem-tools"},
            )
            places = asyncio.Semaphore(self.limits.max_concurrency)
            self._link = _Link(loop, session, places, _proxy_for(self.url), {})
            weakref.finalize(self, close_later, session, loop)
        return self._link


def _fault(error: Exception) -> SearchFault:
    """Return a fault in words of our own: what aiohttp says may hold the address, and so the key."""
    import aiohttp

    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        return SearchFault("its certificate is not accepted", transient=False)
    if isinstance(error, aiohttp.ClientConnectorSSLError):
        return SearchFault("no TLS connection; is it http instead of https?", transient=False)
    if isinstance(error, aiohttp.ClientConnectorDNSError):
        return SearchFault("there is no host of this name")
    if isinstance(error, aiohttp.ConnectionTimeoutError):
        return SearchFault(f"no connection within {CONNECT_TIMEOUT_S:.0f} s")
    if isinstance(error, aiohttp.ClientConnectorError):
        number = error.os_error.errno  # asyncio puts words of its own into strerror
        return SearchFault(f"no connection ({os.strerror(number).lower() if number else 'unknown reason'})")
    if isinstance(error, aiohttp.InvalidURL):
        return SearchFault("it is no address", transient=False)
    if isinstance(error, TimeoutError):
        return SearchFault("no answer in time", transient=False)
    return SearchFault(f"the connection broke ({type(error).__name__})")


def _is_transient(status: int) -> bool:
    """Tell whether the same request may be answered later."""
    return status in (408, 409, 425, 429) or (status >= 500 and status not in (501, 505))


def _retry_after_s(header: str | None) -> float | None:
    """Return the seconds that a ``Retry-After`` header asks for, by number or by date; None if it says nothing.

    Source: RFC 9110, section 10.2.3.
    """
    try:
        seconds = float(header or "")
    except ValueError:
        try:
            seconds = email.utils.parsedate_to_datetime(header or "").timestamp() - time.time()
        except (ValueError, OverflowError):
            return None
    return max(seconds, 0.0) if math.isfinite(seconds) else None


async def _body(response: ClientResponse) -> bytes:
    pieces, size = [], 0
    async for piece in response.content.iter_any():
        size += len(piece)
        if size > MAX_ANSWER_BYTES:
            raise SearchFault(f"the answer is longer than {MAX_ANSWER_BYTES // 1_000_000} MB", transient=False)
        pieces.append(piece)
    return b"".join(pieces)


def _proxy_for(url: str) -> str | None:
    """Return the proxy that the environment names; none for this machine itself."""
    parts = urllib.parse.urlsplit(url)
    host = parts.netloc.rpartition("@")[2]  # proxy_bypass would take a name and password for a part of the host
    if re.fullmatch(r"localhost|127\.[\d.]+|::1", parts.hostname or "") or urllib.request.proxy_bypass(host):
        return None
    return urllib.request.getproxies().get(parts.scheme)
