"""The server of ``gem view``: it only reads, and answers this machine alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from importlib import resources
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from gem_core.errors import ArgumentError, EpisodeFileError, GemError
from gem_eval.episode_data import episode_data, png_of
from gem_eval.show.text import escaped
from gem_eval.turns import outcome_of_row
from gem_eval.viewing.search import search
from gem_eval.viewing.table import NAMES, NUMBERS, Query, answer, choices, row_data

if TYPE_CHECKING:
    from starlette.requests import Request

    from gem_eval.records import Row
    from gem_eval.viewing.library import Library, ViewedRun

MOST_ROWS = 500
"""Rows of the table that are sent at once."""

_ASSETS = {
    "": ("view.html", "text/html"),
    "episode.css": ("episode.css", "text/css"),
    "view.css": ("view.css", "text/css"),
    "episode.js": ("episode.js", "text/javascript"),
    "table.js": ("table.js", "text/javascript"),
    "view.js": ("view.js", "text/javascript"),
}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def make_app(library: Library, is_stopping: Callable[[], bool] = lambda: False) -> Starlette:
    """Return the application.

    Args:
        library: The runs.
        is_stopping: Whether the server is about to end, upon which a search ends.
    """
    pages = _Pages(library, is_stopping)
    routes = [
        *(Route(f"/{name}", _asset(*asset)) for name, asset in _ASSETS.items()),
        Route("/api/runs", pages.runs),
        Route("/api/rows", pages.rows),
        Route("/api/episode", pages.episode),
        Route("/api/image", pages.image),
        Route("/api/search", pages.search),
    ]
    return Starlette(
        routes=routes,
        # Another site's name may be made to point to this machine, and its page would then read what is shown here.
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"], www_redirect=False)],
        exception_handlers={ArgumentError: _refused, EpisodeFileError: _refused},
    )


class _Pages:
    """Answers requests, in a pool of threads."""

    def __init__(self, library: Library, is_stopping: Callable[[], bool]) -> None:
        self._library = library
        self._is_stopping = is_stopping

    def runs(self, _: Request) -> Response:
        return _json([viewed.summary for viewed in self._library.runs])

    def rows(self, request: Request) -> Response:
        runs = tuple((viewed, viewed.version) for viewed in self._runs_of(request))
        places, summary = answer(_query_of(request), runs)
        start, count = _number(request, "start", 0), min(_number(request, "count", 100), MOST_ROWS)
        found: dict[str, Any] = {
            "total": len(places),
            "start": start,
            "rows": [row_data(place) for place in places[start : start + count]],
            "summary": summary,
            "choices": choices(runs),
        }
        if "at" in request.query_params:
            wanted = request.query_params["at"]
            at = (place for place, (run, row) in enumerate(places) if f"{escaped(run.name)}/{row.number}" == wanted)
            found["at"] = next(at, None)
        return _json(found)

    def episode(self, request: Request) -> Response:
        viewed, row = self._row_of(request)
        data = episode_data(viewed.run.record(row))
        place = {
            "run": escaped(viewed.name),
            "number": row.number,
            "model": escaped(row.model),
            "row": escaped(row.row),
        }
        own = {"epoch": row.epoch, "seconds": row.seconds, "cost": row.cost, "outcome": outcome_of_row(row)}
        return _json({**data, **place, **own})

    def image(self, request: Request) -> Response:
        run = self._library.run(request.query_params.get("run", "")).run
        # The name is looked at before a file is: it is that of a hash.
        content = png_of(run.images, request.query_params.get("name", ""))
        return Response(content, media_type="image/png", headers={**_HEADERS, "Cache-Control": "max-age=3600"})

    def search(self, request: Request) -> Response:
        places = _query_of(request).places(self._runs_of(request))
        lines = search(places, request.query_params.get("wanted", ""))
        return StreamingResponse(self._json_lines(lines), media_type="application/x-ndjson", headers=_HEADERS)

    def _json_lines(self, values: Iterator[Any]) -> Iterator[str]:
        for value in values:
            if self._is_stopping():
                return
            yield _plain_json(value) + "\n"

    def _runs_of(self, request: Request) -> list[ViewedRun]:
        names = request.query_params.getlist("run")
        return [self._library.run(name) for name in names] if names else self._library.runs

    def _row_of(self, request: Request) -> tuple[ViewedRun, Row]:
        viewed = self._library.run(request.query_params.get("run", ""))
        return viewed, viewed.run.row(_number(request, "number", 0))


def _query_of(request: Request) -> Query:
    asked = request.query_params
    return Query(
        outcomes=tuple(asked.getlist("outcome")),
        names=tuple((name, tuple(asked.getlist(name))) for name in NAMES if asked.get(name)),
        text=asked.get("text", ""),
        numbers=tuple((name, asked[name]) for name in NUMBERS if asked.get(name)),
        sort=asked.get("sort", ""),
        reverse="reverse" in asked,
    )


def _number(request: Request, name: str, default: int) -> int:
    text = request.query_params.get(name, str(default))
    if not (text.isascii() and text.isdigit() and len(text) < 16):
        raise ArgumentError(f"{name} is {text!r:.100}, and should be a number")
    return int(text)


def _asset(name: str, media_type: str) -> Callable[[Request], Response]:
    def answer(_: Request) -> Response:
        content = (resources.files("gem_eval") / "assets" / name).read_bytes()
        return Response(content, media_type=media_type, headers=_HEADERS)

    return answer


def _refused(_: Request, error: Exception) -> Response:
    status = 422 if isinstance(error, EpisodeFileError) else 400
    return PlainTextResponse(
        escaped(str(error) if isinstance(error, GemError) else "refused"), status, headers=_HEADERS
    )


def _json(value: Any) -> Response:
    return Response(_plain_json(value), media_type="application/json", headers=_HEADERS)


def _plain_json(value: Any) -> str:
    # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
    return json.dumps(value, ensure_ascii=True, allow_nan=False)
