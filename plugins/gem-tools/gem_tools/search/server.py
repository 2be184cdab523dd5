"""A retrieval server in the Search-R1 form: one index on one machine serves many trainers.

``POST /retrieve`` takes ``{"queries": [text, …], "topk": number, "return_scores": bool}`` and answers
``{"result": [[{"document": {"id", "title", "text", "contents"}, "score"}, …], …]}``, one list for each query; without
``return_scores`` the inner lists hold bare documents. ``GET /health`` tells what is served. An error is
``{"error": message}`` with its status.
"""

from __future__ import annotations

import asyncio
import json
import logging
import resource
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aiohttp import web

from gem_tools.search.passages import MAX_TOP_K, Passage, cleaned_query

if TYPE_CHECKING:
    from gem_tools.search.index import Index

MAX_BODY_BYTES = 4_000_000
MAX_QUERIES = 512
SHUTDOWN_S = 5.0

_DEFAULT_TOP_K = 3

logger = logging.getLogger("gem_tools")


class RefusedError(Exception):
    """A request that is answered with status 400."""


def retrieval_app(index: Index) -> web.Application:
    """Return the application that answers requests out of an index."""

    async def health(_: web.Request) -> web.Response:
        return web.json_response({"status": "ok", "passages": len(index)})

    async def retrieve(request: web.Request) -> web.Response:
        queries, top_k, with_scores = _read(await request.read())
        return web.json_response(await asyncio.to_thread(_answer, index, queries, top_k, with_scores))

    app = web.Application(client_max_size=MAX_BODY_BYTES, middlewares=[_errors_as_json])
    app.router.add_post("/retrieve", retrieve)
    app.router.add_get("/health", health)
    return app


@web.middleware
async def _errors_as_json(request: web.Request, handler: Any) -> web.StreamResponse:
    try:
        response: web.StreamResponse = await handler(request)
        return response
    except RefusedError as error:
        status, message = 400, str(error)
    except web.RequestPayloadError:  # as if it is said to be compressed, and is not
        status, message = 400, "the body cannot be read"
    except web.HTTPException as error:
        status, message = error.status, f"{error.reason.lower()}; there are POST /retrieve and GET /health"
    except Exception as error:
        logger.exception("gem: a search failed")
        status, message = 500, f"the search failed ({type(error).__name__})"
    return web.json_response({"error": message}, status=status)


async def serve(index: Index, host: str, port: int, started: Callable[[str], object]) -> None:
    """Serve until Ctrl-C or SIGTERM; requests under way are then still answered.

    Args:
        index: What is searched.
        host: Address to listen on.
        port: 0 for one that is free.
        started: Called with the server's address once it listens.

    Raises:
        OSError: The port is taken, or the address is not this machine's.
    """
    # Each connection is an open file; the usual limit of 1,024 is that of 16 trainers.
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    runner = web.AppRunner(retrieval_app(index), access_log=None, shutdown_timeout=SHUTDOWN_S)
    await runner.setup()
    try:
        site = web.TCPSite(runner, host, port)
        await site.start()
        started(site.name)
        await ended.wait()
    finally:
        await runner.cleanup()


def _read(body: bytes) -> tuple[list[str], int, bool]:
    try:
        asked: Any = json.loads(body)
    except (ValueError, RecursionError):
        raise RefusedError("the body is no JSON") from None
    queries = asked.get("queries") if isinstance(asked, dict) else None
    if not isinstance(queries, list) or not all(isinstance(query, str) for query in queries):
        raise RefusedError('expected {"queries": [text, …], "topk": number, "return_scores": true or false}')
    if len(queries) > MAX_QUERIES:
        raise RefusedError(f"at most {MAX_QUERIES} queries in one request, not {len(queries)}")
    top_k = _DEFAULT_TOP_K if asked.get("topk") is None else asked["topk"]
    if type(top_k) is not int or not 1 <= top_k <= MAX_TOP_K:
        raise RefusedError(f"topk must be a whole number from 1 to {MAX_TOP_K}")
    return queries, top_k, bool(asked.get("return_scores"))


def _answer(index: Index, queries: list[str], top_k: int, with_scores: bool) -> dict[str, Any]:
    found = [index.search(cleaned_query(query)[0], top_k) for query in queries]
    return {
        "result": [
            [{"document": _document(p), "score": p.score} if with_scores else _document(p) for p in passages]
            for passages in found
        ]
    }


def _document(passage: Passage) -> dict[str, str]:
    contents = f'"{passage.title}"\n{passage.text}'
    return {"id": passage.id, "title": passage.title, "text": passage.text, "contents": contents}
