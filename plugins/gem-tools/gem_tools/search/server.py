"""A retrieval server in the Search-R1 form: one index on one machine serves many trainers.

``POST /retrieve`` takes ``{"queries": [text, …], "topk": number, "return_scores": bool}`` and answers
``{"result": [[{"document": {"id", "title", "text", "contents"}, "score"}, …], …]}``, one list for each query; without
``return_scores`` the inner lists hold bare documents. ``GET /health`` tells what is served. An error is
``{"error": message}`` with its status.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import json
import logging
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiohttp import web

from gem_tools.search.listening import Listener
from gem_tools.search.passages import MAX_TOP_K, Passage, cleaned_query

if TYPE_CHECKING:
    from gem_tools.search.index import Index

MAX_BODY_BYTES = 4_000_000
MAX_QUERIES = 512
SHUTDOWN_S = 5.0
BODY_S = 30.0
"""A request whose body takes longer would hold a place for ever."""

_DEFAULT_TOP_K = 3

logger = logging.getLogger("gem_tools")


@dataclass
class Counts:
    """What a server has done."""

    requests: int = 0
    queries: int = 0
    refused: int = 0
    pending: int = 0


class RefusedError(Exception):
    """A request that is answered with an error.

    Args:
        message: What was wrong.
        status: HTTP status.
    """

    def __init__(self, message: str, status: int = 400) -> None:
        super().__init__(message)
        self.status = status


class RetrievalServer:
    """Answers requests out of one index.

    Args:
        index: What is searched.
        workers: Threads that search.
        max_pending: Requests that are answered or wait; more are sent away with status 503.
    """

    def __init__(self, index: Index, *, workers: int, max_pending: int) -> None:
        self.index = index
        self.counts = Counts()
        self._max_pending = max_pending
        self._pool = concurrent.futures.ThreadPoolExecutor(workers, thread_name_prefix="gem-search")

    def app(self) -> web.Application:
        """Return the application."""
        app = web.Application(client_max_size=MAX_BODY_BYTES, middlewares=[_errors_as_json])
        app.router.add_post("/retrieve", self._retrieve)
        app.router.add_get("/health", self._health)
        return app

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    async def _health(self, _: web.Request) -> web.Response:
        return web.json_response({"status": "ok", "passages": len(self.index), **vars(self.counts)})

    async def _retrieve(self, request: web.Request) -> web.Response:
        self.counts.requests += 1
        if self.counts.pending >= self._max_pending:
            self.counts.refused += 1
            return web.json_response({"error": "too many requests at once"}, status=503, headers={"Retry-After": "1"})
        self.counts.pending += 1
        try:
            queries, top_k, with_scores = _read(await _json_of(request))
            self.counts.queries += len(queries)
            loop = asyncio.get_running_loop()
            body = await loop.run_in_executor(self._pool, self._answer, queries, top_k, with_scores)
        except RefusedError as error:
            self.counts.refused += 1
            return web.json_response({"error": str(error)}, status=error.status)
        finally:
            self.counts.pending -= 1
        return web.Response(body=body, content_type="application/json")

    def _answer(self, queries: list[str], top_k: int, with_scores: bool) -> bytes:
        result: list[list[dict[str, Any]]] = []
        for query in queries:
            found = self.index.search(cleaned_query(query).text, top_k)
            documents = map(_document, found)
            if with_scores:
                result.append([{"document": d, "score": p.score} for d, p in zip(documents, found, strict=True)])
            else:
                result.append([*documents])
        return json.dumps({"result": result}).encode()


async def serve(server: RetrievalServer, host: str, port: int, started: Callable[[str], object]) -> None:
    """Serve until the process is told to end, by Ctrl-C or SIGTERM; what is under way then is still answered.

    Args:
        server: Answers the requests.
        host: Address to listen on.
        port: Port; 0 for one that is free.
        started: Called with the server's address once it listens.

    Raises:
        OSError: The port is taken, or the address is not this machine's.
    """
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    listener = Listener(server.app(), shutdown_s=SHUTDOWN_S)
    try:
        bound = await listener.open(host, port)
        started(f"http://{f'[{host}]' if ':' in host else host}:{bound}")
        await ended.wait()
    finally:
        await listener.close()
        server.close()


@web.middleware
async def _errors_as_json(request: web.Request, handler: Any) -> web.StreamResponse:
    """Answer as the others are, where there is no such page, or the search itself failed."""
    try:
        response: web.StreamResponse = await handler(request)
    except web.HTTPException as error:
        headers = {"Allow": error.headers["Allow"]} if "Allow" in error.headers else None
        message = f"{error.reason.lower()}; there are POST /retrieve and GET /health"
        return web.json_response({"error": message}, status=error.status, headers=headers)
    except Exception as error:
        logger.exception("gem: a search failed")
        return web.json_response({"error": f"the search failed ({type(error).__name__})"}, status=500)
    return response


async def _json_of(request: web.Request) -> Any:
    try:
        async with asyncio.timeout(BODY_S):
            body = await request.read()
        return json.loads(body)
    except TimeoutError:
        raise RefusedError(f"the body did not arrive within {BODY_S:g} s", 408) from None
    except web.HTTPRequestEntityTooLarge:
        raise RefusedError(f"the body is longer than {MAX_BODY_BYTES // 1_000_000} MB", 413) from None
    except (ValueError, RecursionError):
        raise RefusedError("the body is no JSON") from None
    except web.RequestPayloadError:  # as where it is said to be compressed, and is not
        raise RefusedError("the body cannot be read") from None


def _read(body: Any) -> tuple[list[str], int, bool]:
    queries = body.get("queries") if isinstance(body, dict) else None
    if not isinstance(queries, list) or not all(isinstance(query, str) for query in queries):
        raise RefusedError('expected {"queries": [text, …], "topk": number, "return_scores": true or false}')
    if len(queries) > MAX_QUERIES:
        raise RefusedError(f"at most {MAX_QUERIES} queries in one request, not {len(queries)}", 413)
    top_k = body.get("topk")
    if top_k is None:
        top_k = _DEFAULT_TOP_K
    if type(top_k) is not int or not 1 <= top_k <= MAX_TOP_K:
        raise RefusedError(f"topk must be a whole number from 1 to {MAX_TOP_K}")
    return queries, top_k, bool(body.get("return_scores"))


def _document(passage: Passage) -> dict[str, str]:
    contents = f'"{passage.title}"\n{passage.text}'
    return {"id": passage.id, "title": passage.title, "text": passage.text, "contents": contents}
