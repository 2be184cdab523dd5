"""``Asked``: a request to a model as all APIs of this endpoint mean it, and ``BadRequestError``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from gem_core import Response


class BadRequestError(Exception):
    """A request cannot be read; the text says what was wrong and what was expected."""


@dataclass
class Asked:
    """A request to a model.

    Args:
        messages: The conversation, in the OpenAI chat format.
        tools: Schemas of the tools, in the OpenAI chat format.
        model: The model that was named.
        stream: Whether the reply is to come in events.
        sampling: What was asked of sampling, as it was written: ``temperature``, ``max_tokens``, ``stop`` …
        with_usage: Whether a stream ends with the token counts.
    """

    messages: list[dict[str, Any]]
    tools: list[dict[str, Any]] = field(default_factory=list)
    model: str = ""
    stream: bool = False
    sampling: dict[str, Any] = field(default_factory=dict)
    with_usage: bool = False


Event = tuple[str | None, Mapping[str, Any] | str]
"""Name of a server-sent event, None for none, and its data."""


class Api(Protocol):
    """How one API writes requests, replies and errors."""

    def read(self, body: Mapping[str, Any]) -> Asked:
        """Return what a request asks.

        Raises:
            BadRequestError: It cannot be read.
        """

    def reply(self, asked: Asked, response: Response, number: str) -> dict[str, Any]:
        """Return the body of a reply that is not streamed; ``number`` tells replies apart."""

    def events(self, asked: Asked, response: Response, number: str) -> Iterator[Event]:
        """Yield the events of a streamed reply."""

    def error(self, status: int, message: str) -> dict[str, Any]:
        """Return the body of an error."""


def text_of(content: object, where: str) -> str | list[dict[str, Any]]:
    """Return content as text, or as content parts in the OpenAI chat format where it has images.

    Args:
        content: Text, None, or parts of the kinds that the three APIs have.
        where: The place, for errors.

    Raises:
        BadRequestError: It is something else.
    """
    if content is None:
        return ""
    if isinstance(content, str):
        return content
    if not isinstance(content, list):
        raise BadRequestError(f"{where} must be text or a list of parts, not {type(content).__name__}")
    parts: list[dict[str, Any]] = []
    for part in content:
        kind = part.get("type") if isinstance(part, Mapping) else None
        if kind in ("text", "input_text", "output_text"):
            parts.append({"type": "text", "text": str(part.get("text", ""))})
        elif kind == "image_url" and isinstance(part.get("image_url"), Mapping):
            parts.append({"type": "image_url", "image_url": dict(part["image_url"])})
        elif kind == "input_image" and isinstance(part.get("image_url"), str):
            parts.append({"type": "image_url", "image_url": {"url": part["image_url"]}})
        elif kind == "image" and isinstance(part.get("source"), Mapping):
            parts.append({"type": "image_url", "image_url": {"url": _image_url(part["source"], where)}})
        else:
            raise BadRequestError(f"{where} has a part of the type {kind!r}; text and images can be read")
    if all(part["type"] == "text" for part in parts):
        return "\n".join(part["text"] for part in parts)
    return parts


def _image_url(source: Mapping[str, Any], where: str) -> str:
    match source:
        case {"type": "base64", "media_type": str(kind), "data": str(data)}:
            return f"data:{kind};base64,{data}"
        case {"type": "url", "url": str(url)}:
            return url
    raise BadRequestError(f"{where} has an image whose source is neither base64 nor a url")


def usage_of(response: Response, asked: Asked) -> tuple[int, int]:
    """Return the tokens of the prompt and of the reply: as the model server told, or else as far as ids are known."""
    told = response.usage or {}
    prompt = told.get("prompt_tokens", told.get("input_tokens", len(response.prompt_token_ids or ())))
    reply = told.get("completion_tokens", told.get("output_tokens", len(response.token_ids or ())))
    return (prompt if isinstance(prompt, int) else 0), (reply if isinstance(reply, int) else 0)


def calls_of(response: Response, number: str) -> Sequence[tuple[str, str, str]]:
    """Return id, name and arguments (JSON text) of each native call of a reply."""
    found = []
    for place, call in enumerate(response.tool_calls or []):
        function = call.get("function") or {}
        found.append(
            (
                str(call.get("id") or f"call_{number}_{place}"),
                str(function.get("name", "")),
                str(function.get("arguments") or "{}"),
            )
        )
    return found
