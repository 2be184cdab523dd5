"""Requests to an OpenAI-compatible server: at most so many at once, each with retries and a deadline.

On aiohttp, for its price: with 64 requests under way each costs 0.2 ms of processor time, where OpenAI's own package
takes 1.6 ms, and httpx2, which that stands on, 0.9 ms. Retries and deadlines are ours in any case.

The key is read from the environment for each request. No attribute, message or record holds it.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import urllib.parse
import urllib.request
import weakref
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_core import __version__
from gem_core.agents.chat_format import JoinedStream, response_from
from gem_core.agents.retries import Clock, is_transient, retry_after_s, wait_s
from gem_core.background import background_loop, close_later
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_core.types import Response

if TYPE_CHECKING:
    from aiohttp import ClientResponse, ClientSession

CONNECT_TIMEOUT_S = 10.0

_KEEP_ALIVE_S = 4.0  # below the 5 s of uvicorn and others, which close a connection while we begin to write
_SHOWN = 300
_REAL_KEY = 16
_SECRET = 6
"""What is shorter, as the "x" that local servers are given, is no secret, and blotted out it would garble words."""

_MASKED_KEY = re.compile(r"\bsk-[\w*.-]{4,}")


class ServerFault(Exception):
    """An attempt, or all attempts, that brought no answer.

    Args:
        message: What went wrong, without the key, in one line.
        status: HTTP status; None when none came.
        code: The server's own word for it, as in ``"model_not_found"``.
        transient: Whether the same request may be answered later.
        retry_after: Seconds that the server asks to wait.
        unreachable: Whether there was no connection at all.
        body: All that the server said, without the key.
    """

    def __init__(
        self,
        message: str,
        *,
        status: int | None = None,
        code: str = "",
        transient: bool = True,
        retry_after: float | None = None,
        unreachable: bool = False,
        body: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.status = status
        self.code = code
        self.transient = transient
        self.retry_after = retry_after
        self.unreachable = unreachable
        self.body = body or message


class _Link(NamedTuple):
    """What belongs to one event loop."""

    loop: asyncio.AbstractEventLoop
    session: ClientSession
    places: asyncio.Semaphore
    proxy: str | None


class _Request(NamedTuple):
    """What is sent: with a body it is posted, without one the path is fetched."""

    path: str
    body: bytes | None = None
    streamed: bool = False


class ChatClient:
    """Sends requests to one server, on the library's loop.

    Args:
        base_url: Address of the server, as in ``http://localhost:8000/v1``.
        key_name: Environment variable that holds the key; without it no key is sent.
        max_concurrency: Requests at once. One that waits for its next attempt keeps its place.
        max_retries: Attempts after the first.
        attempt_timeout_s: Limit of one attempt, in seconds; None for none.
    """

    def __init__(
        self,
        base_url: str,
        key_name: str,
        *,
        max_concurrency: int,
        max_retries: int,
        attempt_timeout_s: float | None = None,
    ) -> None:
        self.base_url = base_url
        self.key_name = key_name
        self.clock = Clock()
        self._max_concurrency = max_concurrency
        self._max_retries = max_retries
        self._attempt_timeout_s = attempt_timeout_s
        self._link: _Link | None = None

    async def fetch(self, path: str, *, timeout_s: float) -> dict[str, Any]:
        """Return what stands at a path, as in ``"/models"``. A server that cannot be reached is not tried again.

        Raises:
            ServerFault: No attempt brought an answer.
        """
        answer: dict[str, Any] = await self._request(_Request(path), timeout_s, None, patient=False)
        return answer

    async def complete(
        self, payload: Mapping[str, Any], *, timeout_s: float, deadline: float | None = None, patient: bool = True
    ) -> Response:
        """Return the response of a model.

        Args:
            payload: The request of the chat API; with ``"stream"`` the chunks are joined.
            timeout_s: Limit from the moment that the request gets its place, all attempts and waits included.
            deadline: Latest time on the clock, the wait for a place included.
            patient: Whether to go on trying a server that cannot be reached.

        Raises:
            ServerFault: No attempt brought an answer.
        """
        request = _Request("/chat/completions", _encoded(payload), bool(payload.get("stream")))
        response: Response = await self._request(request, timeout_s, deadline, patient)
        return response

    async def _request(self, request: _Request, timeout_s: float, deadline: float | None, patient: bool) -> Any:
        link = self._linked()
        await self._take_place(link, deadline)
        try:
            end = self.clock.now() + timeout_s
            return await self._tried(link, request, end if deadline is None else min(end, deadline), patient)
        finally:
            link.places.release()

    async def aclose(self) -> None:
        """Close the connections; the next request opens new ones."""
        link, self._link = self._link, None
        if link is not None:
            await link.session.close()

    def key(self) -> str:
        """Return the key, or nothing where none is set.

        Raises:
            ArgumentError: No HTTP header can hold it.
        """
        key = os.environ.get(self.key_name, "").strip()
        if not (key.isascii() and key.isprintable()):
            raise ArgumentError(f"the key in {self.key_name} has characters that no key has; set it again")
        return key

    def shown(self, text: str) -> str:
        """Return what a server or a library said, fit to be shown: one line, not long, and without the key."""
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in self._bare(text)).split())
        return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"

    def _bare(self, text: str) -> str:
        if len(key := self.key()) >= _SECRET:
            text = text.replace(key, "***").replace(json.dumps(key)[1:-1], "***")
        return _MASKED_KEY.sub("***", text)

    async def _take_place(self, link: _Link, deadline: float | None) -> None:
        try:
            async with self.clock.timeout(None if deadline is None else deadline - self.clock.now()):
                await link.places.acquire()
        except TimeoutError:
            raise ServerFault("the deadline passed before a place among the requests was free") from None

    async def _tried(self, link: _Link, request: _Request, end: float, patient: bool) -> Any:
        attempt = 0
        while True:
            attempt += 1
            fault = await self._attempted(link, request, end - self.clock.now())
            if not isinstance(fault, ServerFault):
                return fault
            times = f" ({attempt} attempts)" if attempt > 1 else ""
            if not fault.transient or attempt > self._max_retries or (fault.unreachable and not patient):
                fault.message += times
                raise fault
            wait = wait_s(self.clock, attempt, fault.retry_after)
            if wait >= end - self.clock.now():
                asked = "" if fault.retry_after is None else f", and it asks to wait {fault.retry_after:.0f} s"
                fault.message += f"{asked}; the time for this request is up{times}"
                raise fault
            await self.clock.sleep(wait)

    async def _attempted(self, link: _Link, request: _Request, left: float) -> ServerFault | Any:
        """Return the answer, or the fault as a value, so that no chain of exceptions drags along what was sent."""
        import aiohttp

        limit = left if self._attempt_timeout_s is None else min(left, self._attempt_timeout_s)
        if limit <= 0:
            return ServerFault("the deadline passed before it was sent", transient=False)
        try:
            async with self.clock.timeout(limit):
                return await self._once(link, request)
        except ServerFault as fault:
            return fault.with_traceback(None)  # whose frames hold the headers
        except aiohttp.ClientConnectorCertificateError as error:
            reason = f"its certificate is not accepted ({self.shown(str(error.certificate_error))})"
            return ServerFault(reason, transient=False, unreachable=True)
        except aiohttp.ClientConnectorSSLError:
            return ServerFault("no TLS connection; is it http instead of https?", transient=False, unreachable=True)
        except aiohttp.ClientConnectorDNSError:
            return ServerFault("there is no host of this name", unreachable=True)
        except (aiohttp.ConnectionTimeoutError, aiohttp.ClientConnectorError) as error:
            return ServerFault(_reason(error), unreachable=True)
        except TimeoutError:
            return ServerFault(f"no answer within {limit:.0f} s")
        except aiohttp.InvalidURL:
            return ServerFault("it is no address", transient=False, unreachable=True)
        except (aiohttp.ClientError, OSError) as error:
            return ServerFault(self.shown(f"the connection broke ({type(error).__name__})"))

    async def _once(self, link: _Link, request: _Request) -> Any:
        headers = {"Content-Type": "application/json"} if request.body is not None else {}
        if key := self.key():
            headers["Authorization"] = f"Bearer {key}"
        # A redirect would take the key elsewhere, and make a GET of a POST.
        async with link.session.request(
            "GET" if request.body is None else "POST",
            self.base_url + request.path,
            data=request.body,
            headers=headers,
            allow_redirects=False,
            proxy=link.proxy,
        ) as response:
            if response.status != 200:
                raise self._refusal(response, await response.read())
            if request.streamed and "json" not in response.headers.get("Content-Type", ""):
                answer = await self._joined(response)
            else:
                answer = _parsed(await response.read())
        try:
            answer = self._checked(answer)
            completed = None if request.body is None else response_from(answer)
        except RecursionError:
            raise ServerFault("the answer is nested too deeply") from None
        if request.body is None:
            return answer
        if completed is None:
            raise ServerFault("the answer has no choices")
        return completed

    async def _joined(self, response: ClientResponse) -> Any:
        joined = JoinedStream()
        async for line in _lines(response):
            if not line.startswith(b"data:"):
                continue
            data = line[5:].strip()
            if data == b"[DONE]":
                joined.finished = True
                break
            chunk = _parsed(data)
            if isinstance(chunk, dict):
                if "error" in chunk and "choices" not in chunk:
                    return chunk
                joined.add(chunk)
        if not joined.finished:
            raise ServerFault("the stream was cut before its end")
        return joined.completion()

    def _checked(self, answer: Any) -> Any:
        """Return an answer that came with status 200, unless it is an error all the same."""
        if not isinstance(answer, dict):
            raise ServerFault(f"the answer is a {type(answer).__name__}, not an object")
        if answer.get("error") and "choices" not in answer:
            message, code = _said(answer)
            status = int(code) if re.fullmatch(r"[45]\d\d", code) else 500
            shown = self.shown(message)
            raise ServerFault(shown, status=status, code=code, transient=is_transient(status), body=self._bare(message))
        key = self.key()
        # A short one, as local servers have, is a word that a model may well use.
        return _without(answer, key) if len(key) >= _REAL_KEY else answer

    def _refusal(self, response: ClientResponse, body: bytes) -> ServerFault:
        text = body.decode("utf-8", "replace")
        code = ""
        try:
            message, code = _said(json.loads(text))
        except (ValueError, RecursionError):
            message = text
        if 300 <= response.status < 400:
            message = f"it redirects to {response.headers.get('Location', 'elsewhere')}"
        return ServerFault(
            f"status {response.status}: {self.shown(message or response.reason or 'no reason given')}",
            status=response.status,
            code=code,
            # No money is no matter of waiting.
            transient=is_transient(response.status) and code != "insufficient_quota",
            retry_after=retry_after_s(response.headers.get("Retry-After"), self.clock.wall()),
            body=self._bare(text),
        )

    def _linked(self) -> _Link:
        loop = background_loop()  # another one after a fork
        if self._link is None or self._link.loop is not loop:
            import aiohttp

            proxy = None if _is_loopback(self.base_url) else _proxy_for(self.base_url)
            session = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=0, keepalive_timeout=_KEEP_ALIVE_S),
                timeout=aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_TIMEOUT_S),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": f"gem-core/{__version__}"},
                read_bufsize=2**20,
            )
            self._link = _Link(loop, session, asyncio.Semaphore(self._max_concurrency), proxy)
            weakref.finalize(self, close_later, session, loop)
        return self._link


async def _lines(response: ClientResponse) -> AsyncIterator[bytes]:
    """Yield the lines of a body, however long: aiohttp's own reader refuses those over its buffer."""
    rest = b""
    async for chunk in response.content.iter_any():
        *whole, rest = (rest + chunk).split(b"\n")
        for line in whole:
            yield line
    if rest:
        yield rest


def _encoded(payload: Mapping[str, Any]) -> bytes:
    # A model's text may hold lone surrogates, which no server can read.
    return json.dumps(payload, ensure_ascii=False).encode("utf-8", "replace")


def _parsed(body: bytes) -> Any:
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        raise ServerFault("the answer is no valid JSON") from None


def _said(answer: Any) -> tuple[str, str]:
    """Return message and code of an error body, in the forms that servers give it."""
    error = answer.get("error", answer) if isinstance(answer, dict) else answer
    if not isinstance(error, dict):
        return str(error), ""
    message = error.get("message") or error.get("detail") or json.dumps(error)
    return str(message), str(error.get("code") or error.get("type") or "")


def _without(value: Any, key: str) -> Any:
    if isinstance(value, str):
        return value.replace(key, "***")
    if isinstance(value, dict):
        return {name: _without(part, key) for name, part in value.items()}
    if isinstance(value, list) and not (value and isinstance(value[0], int)):
        return [_without(part, key) for part in value]
    return value


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    if isinstance(error, TimeoutError):
        return f"no connection within {CONNECT_TIMEOUT_S:.0f} s"
    return os.strerror(number).lower() if isinstance(number, int) and number > 0 else "no connection"


def _is_loopback(url: str) -> bool:
    return re.match(r"https?://(localhost|127\.[\d.]+|\[::1\])(:\d+)?(/|$)", url) is not None


def _proxy_for(url: str) -> str | None:
    """Return the proxy that the environment names, which may hold a password.

    aiohttp's own ``trust_env`` also reads ``~/.netrc``, sends what it finds there, and raises beside a key.
    """
    parts = urllib.parse.urlsplit(url)
    if urllib.request.proxy_bypass(parts.netloc):
        return None
    return urllib.request.getproxies().get(parts.scheme)


def check_installed() -> None:
    """Raise when the package for HTTP is missing.

    Raises:
        MissingRequirementError: Gives the command that installs it.
    """
    import importlib.util

    if importlib.util.find_spec("aiohttp") is None:
        raise MissingRequirementError("the agent 'openai' needs aiohttp: pip install 'gem-core[openai]'")
