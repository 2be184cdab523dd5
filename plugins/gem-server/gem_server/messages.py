"""The Anthropic Messages API: ``POST /v1/messages``.

Source: https://docs.anthropic.com/en/api/messages and /en/api/messages-streaming.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from gem_core import Response
from gem_server.asked import Asked, BadRequestError, Event, calls_of, text_of, usage_of

_SAMPLING = ("temperature", "top_p", "top_k", "max_tokens", "stop_sequences", "tool_choice", "thinking")


def read(body: Mapping[str, Any]) -> Asked:
    """Return what a request asks; see ``Api``."""
    given = body.get("messages")
    if not isinstance(given, list) or not given:
        raise BadRequestError("messages must be a list with at least one message")
    messages: list[dict[str, Any]] = []
    if body.get("system"):
        messages.append({"role": "system", "content": text_of(body["system"], "system")})
    for place, message in enumerate(given):
        where = f"messages[{place}]"
        if not isinstance(message, Mapping) or message.get("role") not in ("user", "assistant", "system"):
            raise BadRequestError(f"{where} must be an object with the role user or assistant")
        messages += _read_message(message["role"], message.get("content"), where)
    tools = []
    for tool in body.get("tools") or []:
        if not isinstance(tool, Mapping) or not isinstance(tool.get("name"), str):
            raise BadRequestError("each of tools must be an object with a name")
        schema = {
            "name": tool["name"],
            "description": tool.get("description", ""),
            "parameters": tool.get("input_schema", {}),
        }
        tools.append({"type": "function", "function": schema})
    sampling = {name: body[name] for name in _SAMPLING if body.get(name) is not None}
    return Asked(messages, tools, str(body.get("model") or ""), bool(body.get("stream")), sampling)


def _read_message(role: str, content: object, where: str) -> list[dict[str, Any]]:
    """Return a message in the chat format: the results of tools become messages of their own, before the rest."""
    if not isinstance(content, list):
        return [{"role": role, "content": text_of(content, f"{where}.content")}]
    results: list[dict[str, Any]] = []
    calls: list[dict[str, Any]] = []
    rest = []
    reasoning = ""
    for part in content:
        match part:
            case {"type": "tool_result", "tool_use_id": str(call_id)}:
                text = text_of(part.get("content"), f"{where}.content")
                results.append({"role": "tool", "tool_call_id": call_id, "content": text})
            case {"type": "tool_use", "id": str(call_id), "name": str(name)}:
                function = {"name": name, "arguments": json.dumps(part.get("input") or {})}
                calls.append({"id": call_id, "type": "function", "function": function})
            case {"type": "thinking", "thinking": str(thinking)}:
                reasoning += thinking
            case {"type": "redacted_thinking"}:
                continue
            case _:
                rest.append(part)
    if results and not rest:
        return results
    message: dict[str, Any] = {"role": role, "content": text_of(rest, f"{where}.content")}
    if calls:
        message["tool_calls"] = calls
    if reasoning:
        message["reasoning_content"] = reasoning
    return [*results, message]


def _blocks(response: Response, number: str) -> list[dict[str, Any]]:
    blocks: list[dict[str, Any]] = []
    if response.reasoning:
        blocks.append({"type": "thinking", "thinking": response.reasoning, "signature": ""})
    calls = calls_of(response, number)
    if response.text or not calls:
        blocks.append({"type": "text", "text": response.text})
    for call_id, name, arguments in calls:
        blocks.append({"type": "tool_use", "id": call_id, "name": name, "input": _object(arguments)})
    return blocks


def _object(arguments: str) -> dict[str, Any]:
    try:
        read_as = json.loads(arguments)
    except ValueError:
        return {"arguments": arguments}  # what the model wrote, though it is no JSON
    return read_as if isinstance(read_as, dict) else {"arguments": read_as}


def _stop(response: Response) -> str:
    if response.tool_calls:
        return "tool_use"
    return "max_tokens" if response.cut_off else "end_turn"


def _usage(asked: Asked, response: Response) -> dict[str, int]:
    prompt, reply = usage_of(response, asked)
    return {"input_tokens": prompt, "output_tokens": reply}


def reply(asked: Asked, response: Response, number: str) -> dict[str, Any]:
    """Return the body of a reply; see ``Api``."""
    return {
        "id": f"msg_{number}",
        "type": "message",
        "role": "assistant",
        "model": response.model or asked.model,
        "content": _blocks(response, number),
        "stop_reason": _stop(response),
        "stop_sequence": None,
        "usage": _usage(asked, response),
    }


def events(asked: Asked, response: Response, number: str) -> Iterator[Event]:
    """Yield the events of a streamed reply; see ``Api``."""
    usage = _usage(asked, response)

    def event(kind: str, /, **fields: Any) -> Event:
        return kind, {"type": kind, **fields}

    whole = reply(asked, response, number)
    begun = {**whole, "content": [], "stop_reason": None, "usage": {**usage, "output_tokens": 0}}
    yield event("message_start", message=begun)
    for index, block in enumerate(whole["content"]):
        kind = block["type"]
        if kind == "tool_use":
            yield event("content_block_start", index=index, content_block={**block, "input": {}})
            delta = {"type": "input_json_delta", "partial_json": json.dumps(block["input"])}
        elif kind == "thinking":
            yield event(
                "content_block_start", index=index, content_block={"type": kind, "thinking": "", "signature": ""}
            )
            delta = {"type": "thinking_delta", "thinking": block["thinking"]}
        else:
            yield event("content_block_start", index=index, content_block={"type": kind, "text": ""})
            delta = {"type": "text_delta", "text": block["text"]}
        yield event("content_block_delta", index=index, delta=delta)
        yield event("content_block_stop", index=index)
    yield event("message_delta", delta={"stop_reason": whole["stop_reason"], "stop_sequence": None}, usage=usage)
    yield event("message_stop")


def error(status: int, message: str) -> dict[str, Any]:
    """Return the body of an error; see ``Api``."""
    kinds = {
        401: "authentication_error",
        404: "not_found_error",
        413: "request_too_large",
        429: "rate_limit_error",
        529: "overloaded_error",
    }
    kind = kinds.get(status, "api_error" if status >= 500 else "invalid_request_error")
    return {"type": "error", "error": {"type": kind, "message": message}}
