"""The conversation of an episode as inspect_ai's messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from gem_core import Episode

_ROLES = {"system": "system", "developer": "system", "user": "user", "assistant": "assistant", "tool": "tool"}

ImageUrl = Callable[[Any], str | None]
"""Returns an image as a data URL; None where it cannot be read."""


def messages_of(episode: Episode, image_url: ImageUrl) -> list[dict[str, Any]]:
    """Return the conversation of an episode, reasoning included.

    Args:
        episode: The episode, its images as names of files.
        image_url: Reads an image.
    """
    messages = [_message(message, image_url) for message in episode.messages]
    answers = [message for message in messages if message["role"] == "assistant"]
    # A chat that the environment keeps itself may show other responses than those that were given.
    if len(answers) == len(episode.transitions):
        for answer, turn in zip(answers, episode.transitions, strict=True):
            if turn.action.reasoning:
                thought = {"type": "reasoning", "reasoning": turn.action.reasoning}
                answer["content"] = [thought, *as_parts(answer["content"])]
            if turn.action.tool_calls and not answer.get("tool_calls"):
                answer["tool_calls"] = [_tool_call(call, place) for place, call in enumerate(turn.action.tool_calls)]
            if turn.action.model:
                answer["model"] = str(turn.action.model)
    names: dict[str, str] = {}
    for message in messages:
        names |= {call["id"]: call["function"] for call in message.get("tool_calls", ())}
        if message["role"] == "tool" and message.get("tool_call_id") in names:
            message["function"] = names[message["tool_call_id"]]
    return messages


def _message(message: Mapping[str, Any], image_url: ImageUrl) -> dict[str, Any]:
    role = _ROLES.get(str(message.get("role")), "user")
    told: dict[str, Any] = {"role": role, "content": _content(message.get("content"), image_url)}
    calls = message.get("tool_calls")
    if role == "assistant":
        told["source"] = "generate"
        if isinstance(calls, list) and calls:
            told["tool_calls"] = [_tool_call(call, place) for place, call in enumerate(calls)]
    if role == "tool":
        told["tool_call_id"] = str(message.get("tool_call_id", ""))
    return told


def _content(content: Any, image_url: ImageUrl) -> str | list[dict[str, Any]]:
    if isinstance(content, list):
        return [_part(part, image_url) for part in content]
    return "" if content is None else content if isinstance(content, str) else json.dumps(content, default=repr)


def _part(part: Any, image_url: ImageUrl) -> dict[str, Any]:
    if isinstance(part, Mapping) and part.get("type") == "text":
        return {"type": "text", "text": str(part.get("text", ""))}
    if isinstance(part, Mapping) and part.get("type") == "image":
        url = image_url(part.get("image"))
        unread = {"type": "text", "text": "[an image that cannot be read]"}
        return unread if url is None else {"type": "image", "image": url}
    return {"type": "text", "text": part if isinstance(part, str) else json.dumps(part, default=repr)}


def as_parts(content: str | list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the content of a message as parts."""
    return [{"type": "text", "text": content}] if isinstance(content, str) else content


def _tool_call(call: Any, place: int) -> dict[str, Any]:
    """Return a native call; arguments that are no JSON object stand under ``"arguments"`` as they were written."""
    function = call.get("function") if isinstance(call, Mapping) else None
    function = function if isinstance(function, Mapping) else {}
    written = function.get("arguments")
    told = {"id": str((isinstance(call, Mapping) and call.get("id")) or f"call_{place}"), "type": "function"}
    told["function"] = str(function.get("name", ""))
    try:
        arguments = json.loads(written) if isinstance(written, str) else written
        fault = None if isinstance(arguments, dict) else "the arguments are no JSON object"
    except (ValueError, RecursionError) as error:
        arguments, fault = None, f"the arguments are no JSON ({error})"
    return {**told, "arguments": arguments if fault is None else {"arguments": written}, "parse_error": fault}
