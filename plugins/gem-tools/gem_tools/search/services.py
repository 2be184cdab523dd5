"""What retrieval servers and web search engines are asked, and what they answer: pure functions, no connection.

Answers come from outside: whatever in them has not the expected form is left out, and never an exception.

Sources: Search-R1's ``retrieval_server.py`` (PeterGriffinJin/Search-R1), and the API pages of serper.dev, serpapi.com
and tavily.com.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_tools.search.corpus import split_contents
from gem_tools.search.passages import Passage


class AnswerError(Exception):
    """An answer that is none: an error in a whole response, or something quite different."""


class Sent(NamedTuple):
    """A request.

    Args:
        method: Of HTTP.
        params: What stands behind the question mark of the address.
        headers: More headers.
        body: What is posted as JSON; None for nothing.
    """

    method: str
    params: Mapping[str, str]
    headers: Mapping[str, str]
    body: Mapping[str, Any] | None


@dataclass(frozen=True)
class Service:
    """A kind of server.

    Args:
        name: The engine's name.
        url: Where it is reached; empty where that differs from user to user.
        url_name: Environment variable that may hold the address instead.
        key_name: Environment variable that holds the key; empty where none is needed.
        request: Called with query, number of passages and key.
        read: Returns the passages of an answer.
    """

    name: str
    request: Callable[[str, int, str], Sent]
    read: Callable[[Any], list[Passage]]
    url: str = ""
    url_name: str = ""
    key_name: str = field(default="")


def find_service(name: str) -> Service:
    """Return a service by its name.

    Raises:
        ArgumentError: There is none of that name.
    """
    service = SERVICES.get(name)
    if service is None:
        names = ["local", *SERVICES]
        hint = did_you_mean(name, names) if isinstance(name, str) else ""
        raise ArgumentError(f"no search engine {name!r}.{hint} There are: {', '.join(names)}")
    return service


def _ask_retrieve(query: str, top_k: int, key: str) -> Sent:
    # Without scores, servers of this form answer with status 500.
    return Sent("POST", {}, {}, {"queries": [query], "topk": top_k, "return_scores": True})


def _read_retrieve(answer: Any) -> list[Passage]:
    if not isinstance(answer, dict) or not isinstance(answer.get("result"), list):
        raise AnswerError("the answer has no list under 'result'")
    rows = answer["result"]
    # One list for each query; some servers leave out the outer one.
    items = rows[0] if rows and isinstance(rows[0], list) else rows
    return [passage for item in items if (passage := _retrieved(item)) is not None]


def _retrieved(item: Any) -> Passage | None:
    document = item.get("document", item) if isinstance(item, dict) else item
    score = _number(item.get("score")) if isinstance(item, dict) else None
    if isinstance(document, str):
        document = {"contents": document}
    if not isinstance(document, dict):
        return None
    title, text = _text(document, "title"), _text(document, "text")
    if not text:
        first, text = split_contents(_text(document, "contents"))
        title = title or first
    name = document.get("id")
    return Passage(str(name) if isinstance(name, str | int) else "", title, text, score) if text or title else None


def _ask_serper(query: str, top_k: int, key: str) -> Sent:
    return Sent("POST", {}, {"X-API-KEY": key}, {"q": query, "num": top_k})


def _read_serper(answer: Any) -> list[Passage]:
    found = _object(answer)
    first = [_boxed(found.get("answerBox"), "answer", "snippet"), _boxed(found.get("knowledgeGraph"), "description")]
    return [*filter(None, first), *_results(found, "organic", "snippet", "link")]


def _ask_serpapi(query: str, top_k: int, key: str) -> Sent:
    return Sent("GET", {"engine": "google", "q": query, "num": str(top_k), "api_key": key}, {}, None)


def _read_serpapi(answer: Any) -> list[Passage]:
    found = _object(answer)
    error = found.get("error")
    # Finding nothing is told as an error.
    if error and not found.get("organic_results") and "returned any results" not in str(error):
        raise AnswerError(f"it says: {error}")
    first = [_boxed(found.get("answer_box"), "answer", "snippet"), _boxed(found.get("knowledge_graph"), "description")]
    return [*filter(None, first), *_results(found, "organic_results", "snippet", "link")]


def _ask_tavily(query: str, top_k: int, key: str) -> Sent:
    body = {"query": query, "max_results": min(top_k, 20), "search_depth": "basic", "include_answer": False}
    return Sent("POST", {}, {"Authorization": f"Bearer {key}"}, body)


def _read_tavily(answer: Any) -> list[Passage]:
    return _results(_object(answer), "results", "content", "url")


def _results(found: dict[str, Any], name: str, text: str, url: str) -> list[Passage]:
    rows = found.get(name)
    passages = []
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict) and (_text(row, text) or _text(row, "title")):
            score = _number(row.get("score"))
            passages.append(Passage("", _text(row, "title"), _text(row, text), score, _text(row, url)))
    return passages


def _boxed(box: Any, *names: str) -> Passage | None:
    """Return what an engine puts above the results as a passage."""
    if isinstance(box, list):
        box = box[0] if box else None
    if not isinstance(box, dict):
        return None
    texts = [_text(box, name) for name in names]
    text = "\n".join(dict.fromkeys(filter(None, texts)))
    return Passage("", _text(box, "title") or "Answer", text, None, _text(box, "link")) if text else None


def _object(answer: Any) -> dict[str, Any]:
    if not isinstance(answer, dict):
        raise AnswerError(f"the answer is a {type(answer).__name__}, not an object")
    return answer


def _text(row: dict[str, Any], name: str) -> str:
    value = row.get(name)
    return value if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    # A boolean is an int, an int may be too large for a float, and what is not finite is no JSON.
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


SERVICES: dict[str, Service] = {
    service.name: service
    for service in (
        Service("retrieve", _ask_retrieve, _read_retrieve, url_name="SEARCH_URL"),
        Service("serper", _ask_serper, _read_serper, url="https://google.serper.dev/search", key_name="SERPER_API_KEY"),
        Service("serpapi", _ask_serpapi, _read_serpapi, url="https://serpapi.com/search", key_name="SERPAPI_API_KEY"),
        Service("tavily", _ask_tavily, _read_tavily, url="https://api.tavily.com/search", key_name="TAVILY_API_KEY"),
    )
}
"""Every kind of server that can be asked, by the engine's name."""
