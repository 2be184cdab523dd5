"""Requests to an OpenAI-compatible server: a bounded number at once, each with retries and a deadline.

On aiohttp, for its price: with 64 requests under way each costs 0.2 ms of processor time, where OpenAI's own package
takes 1.6 ms, and httpx2, on which that stands, 0.9 ms. Retries by tenacity cost 0.04 ms more.

The key is read from the environment for each request. No attribute, message or record holds it.
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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import aiohttp
import tenacity

from gem_core import Response, __version__
from gem_core.background import background_loop, close_later
from gem_core.errors import ArgumentError
from gem_openai.chat_format import completion_of, response_from

CONNECT_TIMEOUT_S = 10.0
MAX_ANSWER_BYTES = 256 * 2**20
"""100,000 tokens with 20 alternatives each have 200 MB; a server that never ends sends gigabytes in time."""

_KEEP_ALIVE_S = 4.0  # below the 5 s of uvicorn and others, which close a connection while we begin to write
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 30.0
_GROWING_WAIT_S = tenacity.wait_exponential(multiplier=_FIRST_WAIT_S, max=_LONGEST_WAIT_S)
_SHOWN_CHARS = 300
_SHORTEST_SECRET = 6  # a shorter key, as the "x" that local servers are given, is no secret, and part of many words
_SHORTEST_IN_ANSWER = 16  # a model may well write a shorter one, as "lm-studio"
_MASKED_KEY = re.compile(r"\bsk-[\w*.-]{4,}")


@dataclass(eq=False, repr=False)
class ServerFault(Exception):
    """An attempt, or all attempts, without an answer.

    Args:
        message: What went wrong, without the key, in one line.
        status: HTTP status; None when none came.
        code: The server's own word for it, as in ``"model_not_found"``.
        transient: Whether the same request may be answered later.
        retry_after: Seconds that the server asks to wait.
        unreachable: Whether there was no connection at all.
        body: All that the server said, without the key.
        timed_out: Whether there was a connection, and no answer in time.
    """

    message: str
    status: int | None = None
    code: str = ""
    transient: bool = True
    retry_after: float | None = None
    unreachable: bool = False
    body: str = ""
    timed_out: bool = False

    @property
    def cause(self) -> str:
        """What records call it: ``timeout``, ``rate_limit``, ``server``, ``refused`` or ``connection``."""
        if self.timed_out:
            return "timeout"
        if self.status is None:
            return "connection"
        return "rate_limit" if self.status == 429 else "server" if self.status >= 500 else "refused"


class _Link(NamedTuple):
    """State that belongs to one event loop."""

    loop: asyncio.AbstractEventLoop
    session: aiohttp.ClientSession
    places: asyncio.Semaphore
    proxy: str | None


class _Request(NamedTuple):
    """What is sent: posted where it has a body, else fetched; and how long it may take."""

    path: str
    body: bytes | None
    streamed: bool
    end: float
    patient: bool


class ChatClient:
    """Sends requests to one server, on the library's loop.

    Args:
        base_url: Address of the server, as in ``http://localhost:8000/v1``.
        key_name: Environment variable that holds the key; without it no key is sent.
        max_concurrency: Requests at once. One that waits for its next attempt keeps its place.
        max_retries: Attempts after the first.
        attempt_timeout_s: Limit of one attempt, in seconds; None for none.

    ``sleep`` and ``jitter`` (a random number between two) are used for waits between attempts.
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
        self.sleep = asyncio.sleep
        # A generator of its own: jitter must differ between processes and touch nobody's random state.
        self.jitter = random.Random().uniform
        self._max_concurrency = max_concurrency
        self._max_retries = max_retries
        self._attempt_timeout_s = attempt_timeout_s
        self._link: _Link | None = None

    async def request(
        self,
        path: str,
        payload: Mapping[str, Any] | None = None,
        *,
        timeout_s: float,
        deadline: float | None = None,
        patient: bool = True,
    ) -> Any:
        """Return the ``Response`` to a payload that is posted, or without one the JSON object that a path holds.

        Args:
            path: As in ``"/chat/completions"``.
            payload: The request of the chat API; with ``"stream"`` the chunks are joined.
            timeout_s: Limit from the moment that the request gets its place, all attempts and waits included.
            deadline: Latest time on ``time.monotonic()``, the wait for a place included.
            patient: Whether to go on trying a server that cannot be reached.

        Raises:
            ServerFault: No attempt brought an answer.
        """
        # A model's text may hold lone surrogates, which no server can read.
        body = None if payload is None else json.dumps(payload, ensure_ascii=False).encode("utf-8", "replace")
        link = self._linked()
        try:
            async with asyncio.timeout(None if deadline is None else deadline - time.monotonic()):
                await link.places.acquire()
        except TimeoutError:
            raise ServerFault(
                "the deadline passed before a place among the requests was free", timed_out=True
            ) from None
        try:
            end = time.monotonic() + timeout_s
            end = end if deadline is None else min(end, deadline)
            streamed = payload is not None and bool(payload.get("stream"))
            return await self._with_retries(link, _Request(path, body, streamed, end, patient))
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
        """Return a message of a server or library in one short line, without the key."""
        text = _MASKED_KEY.sub("***", self._without_key(text, _SHORTEST_SECRET))
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
        return text if len(text) <= _SHOWN_CHARS else f"{text[:_SHOWN_CHARS]}…"

    def _without_key(self, text: str, shortest: int) -> str:
        key = self.key()
        if len(key) < shortest:
            return text
        return text.replace(key, "***").replace(json.dumps(key)[1:-1], "***")

    # Attempts.

    async def _with_retries(self, link: _Link, request: _Request) -> Any:
        def may_pass(error: BaseException) -> bool:
            return isinstance(error, ServerFault) and error.transient and (request.patient or not error.unreachable)

        retrying = tenacity.AsyncRetrying(
            retry=tenacity.retry_if_exception(may_pass),
            wait=self._wait_s,
            stop=tenacity.stop_after_attempt(1 + self._max_retries)
            | tenacity.stop_before_delay(request.end - time.monotonic()),
            sleep=self.sleep,
            reraise=True,
        )
        try:
            return await retrying(self._attempt, link, request)
        except ServerFault as fault:
            attempts = retrying.statistics["attempt_number"]
            if may_pass(fault) and attempts <= self._max_retries:
                asked = "" if fault.retry_after is None else f", and it asks to wait {fault.retry_after:.0f} s"
                fault.message += f"{asked}; the time for this request is up"
            fault.message += f" ({attempts} attempts)" if attempts > 1 else ""
            raise

    def _wait_s(self, state: tenacity.RetryCallState) -> float:
        """Return how long to wait for the next attempt.

        Where the server asks for a time, a little chance comes on top, so that not all whom it sent away come back in
        one instant.

        Source: "full jitter", https://aws.amazon.com/blogs/architecture/exponential-backoff-and-jitter/.
        """
        fault = state.outcome.exception() if state.outcome else None
        if isinstance(fault, ServerFault) and fault.retry_after is not None:
            return fault.retry_after + self.jitter(0.0, _FIRST_WAIT_S)
        return self.jitter(0.0, _GROWING_WAIT_S(state))

    async def _attempt(self, link: _Link, request: _Request) -> Any:
        left = request.end - time.monotonic()
        limit = left if self._attempt_timeout_s is None else min(left, self._attempt_timeout_s)
        if limit <= 0:
            raise ServerFault("the deadline passed before it was sent", transient=False, timed_out=True)
        try:
            async with asyncio.timeout(limit):
                return await self._exchange(link, request)
        except (aiohttp.ClientError, OSError) as error:  # TimeoutError is one of these
            fault = self._fault_of(error, limit)
        raise fault  # outside of the clause: aiohttp's error would go along, whose frames hold headers and so the key

    async def _exchange(self, link: _Link, request: _Request) -> Any:
        # The headers are in no variable: tools that report errors show those of every frame.
        # A redirect would take the key elsewhere, and make a GET of a POST.
        async with link.session.request(
            "GET" if request.body is None else "POST",
            self.base_url + request.path,
            data=request.body,
            headers=self._headers(request),
            allow_redirects=False,
            proxy=link.proxy,
        ) as response:
            text = (await _body(response)).decode("utf-8-sig", "replace")
            text = self._without_key(text, _SHORTEST_IN_ANSWER if response.status == 200 else _SHORTEST_SECRET)
            if response.status != 200:
                raise self._refusal(response, text)
        in_chunks = request.streamed and "json" not in response.headers.get("Content-Type", "")
        try:
            answer = _joined(text) if in_chunks else json.loads(text)
        except (ValueError, RecursionError):
            raise ServerFault("the answer is no valid JSON") from None
        if not isinstance(answer, dict):
            raise ServerFault(f"the answer is a {type(answer).__name__}, not an object")
        if answer.get("error") and "choices" not in answer:
            raise self._fault_with_status_200(answer)
        return answer if request.body is None else _response(answer)

    def _headers(self, request: _Request) -> dict[str, str]:
        headers = {} if request.body is None else {"Content-Type": "application/json"}
        return {**headers, "Authorization": f"Bearer {key}"} if (key := self.key()) else headers

    # Faults.

    def _refusal(self, response: aiohttp.ClientResponse, text: str) -> ServerFault:
        try:
            message, code = _said(json.loads(text))
        except (ValueError, RecursionError):
            message, code = text, ""
        if 300 <= response.status < 400:
            message = f"it redirects to {response.headers.get('Location', 'elsewhere')}"
        return ServerFault(
            f"status {response.status}: {self.shown(message or response.reason or 'no reason given')}",
            status=response.status,
            code=code,
            transient=_is_transient(response.status) and code != "insufficient_quota",
            retry_after=_retry_after_s(response.headers.get("Retry-After")),
            body=text,
        )

    def _fault_with_status_200(self, answer: Mapping[str, Any]) -> ServerFault:
        message, code = _said(answer)
        status = int(code) if re.fullmatch(r"[45]\d\d", code) else 500
        return ServerFault(self.shown(message), status, code, transient=_is_transient(status), body=message)

    def _fault_of(self, error: Exception, limit_s: float) -> ServerFault:
        if isinstance(error, aiohttp.ClientConnectorCertificateError):
            reason = f"its certificate is not accepted ({self.shown(str(error.certificate_error))})"
            return ServerFault(reason, transient=False, unreachable=True)
        if isinstance(error, aiohttp.ClientConnectorSSLError):
            return ServerFault("no TLS connection; is it http instead of https?", transient=False, unreachable=True)
        if isinstance(error, aiohttp.ClientConnectorDNSError):
            return ServerFault("there is no host of this name", unreachable=True)
        if isinstance(error, aiohttp.ConnectionTimeoutError):
            return ServerFault(f"no connection within {CONNECT_TIMEOUT_S:.0f} s", unreachable=True)
        if isinstance(error, aiohttp.ClientConnectorError):
            number = error.errno
            return ServerFault(os.strerror(number).lower() if number else "no connection", unreachable=True)
        if isinstance(error, TimeoutError):
            return ServerFault(f"no answer within {limit_s:.0f} s", timed_out=True)
        if isinstance(error, aiohttp.InvalidURL):
            return ServerFault("it is no address", transient=False, unreachable=True)
        return ServerFault(f"the connection broke ({type(error).__name__})")

    # The connection.

    def _linked(self) -> _Link:
        loop = background_loop()  # another one after a fork
        if self._link is None or self._link.loop is not loop:
            session = aiohttp.ClientSession(
                connector=aiohttp.TCPConnector(limit=0, keepalive_timeout=_KEEP_ALIVE_S),
                timeout=aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_TIMEOUT_S),
                cookie_jar=aiohttp.DummyCookieJar(),
                headers={"User-Agent": f"gem-core/{__version__}"},
                read_bufsize=2**20,
            )
            self._link = _Link(loop, session, asyncio.Semaphore(self._max_concurrency), _proxy_for(self.base_url))
            weakref.finalize(self, close_later, session, loop)
        return self._link


async def _body(response: aiohttp.ClientResponse) -> bytes:
    chunks, length = [], 0
    async for chunk in response.content.iter_any():
        chunks.append(chunk)
        length += len(chunk)
        if length > MAX_ANSWER_BYTES:
            raise ServerFault(f"the answer has more than {MAX_ANSWER_BYTES:,} bytes", transient=False)
    return b"".join(chunks)


def _joined(text: str) -> Any:
    """Return the completion, or the error, from server-sent events.

    Raises:
        ServerFault: The stream ends before the model did.
        ValueError: A chunk is no JSON.
    """
    chunks: list[dict[str, Any]] = []
    for line in text.split("\n"):
        data = line[5:].strip() if line.startswith("data:") else ""
        if data == "[DONE]":
            return completion_of(chunks)
        chunk = json.loads(data) if data else None
        if isinstance(chunk, dict):
            if "error" in chunk and "choices" not in chunk:
                return chunk
            chunks.append(chunk)
    completion = completion_of(chunks)
    if completion["choices"][0]["finish_reason"] is None:
        raise ServerFault("the stream was cut before its end")
    return completion


def _response(answer: Mapping[str, Any]) -> Response:
    try:
        response = response_from(answer)
    except RecursionError:
        raise ServerFault("the answer is nested too deeply") from None
    if response is None:
        raise ServerFault("the answer has no choices")
    return response


def _said(answer: Any) -> tuple[str, str]:
    """Return message and code of an error body, in the forms that servers give it."""
    error = answer.get("error", answer) if isinstance(answer, dict) else answer
    if not isinstance(error, dict):
        return str(error), ""
    message = error.get("message") or error.get("detail") or json.dumps(error)
    return str(message), str(error.get("code") or error.get("type") or "")


def _is_transient(status: int) -> bool:
    """Tell whether the same request may be answered later.

    409 is what servers answer while they take turns at a lock, and what OpenAI's own client tries again.
    """
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


def _proxy_for(url: str) -> str | None:
    """Return the proxy that the environment names; none for this machine itself.

    aiohttp's own ``trust_env`` also reads ``~/.netrc``, sends what it finds there, and raises beside a key.
    """
    parts = urllib.parse.urlsplit(url)
    is_here = re.fullmatch(r"localhost|127\.[\d.]+|::1", parts.hostname or "")
    if is_here or urllib.request.proxy_bypass(parts.netloc):
        return None
    return urllib.request.getproxies().get(parts.scheme)
