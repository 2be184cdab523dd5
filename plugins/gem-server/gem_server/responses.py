"""The OpenAI Responses API: ``POST /v1/responses``; nothing is stored, so each request brings its whole conversation.

Source: https://platform.openai.com/docs/api-reference/responses and /responses-streaming.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from typing import Any

from gem_core import Response
from gem_server import chat
from gem_server.asked import Asked, BadRequestError, Event, calls_of, text_of, usage_of

_SAMPLING = ("temperature", "top_p", "max_output_tokens", "tool_choice", "parallel_tool_calls", "reasoning", "text")


def read(body: Mapping[str, Any]) -> Asked:
    """Return what a request asks; see ``Api``."""
    if body.get("previous_response_id"):
        raise BadRequestError("previous_response_id: this server stores nothing; send the whole conversation as input")
    given = body.get("input")
    items = [{"role": "user", "content": given}] if isinstance(given, str) else given
    if not isinstance(items, list) or not items:
        raise BadRequestError("input must be text, or a list with at least one item")
    messages: list[dict[str, Any]] = []
    if body.get("instructions"):
        messages.append({"role": "system", "content": text_of(body["instructions"], "instructions")})
    for place, item in enumerate(items):
        _read_item(messages, item, f"input[{place}]")
    tools = []
    for tool in body.get("tools") or []:
        if (
            isinstance(tool, Mapping)
            and tool.get("type") in ("function", "custom")
            and isinstance(tool.get("name"), str)
        ):
            schema = {
                "name": tool["name"],
                "description": tool.get("description") or "",
                "parameters": tool.get("parameters") or {},
            }
            tools.append({"type": "function", "function": schema})  # tools that OpenAI's own servers run are left out
    sampling = {name: body[name] for name in _SAMPLING if body.get(name) is not None}
    return Asked(messages, tools, str(body.get("model") or ""), bool(body.get("stream")), sampling)


def _read_item(messages: list[dict[str, Any]], item: object, where: str) -> None:
    if not isinstance(item, Mapping):
        raise BadRequestError(f"{where} must be an object, not {type(item).__name__}")
    kind = item.get("type", "message")
    if kind == "message" and isinstance(item.get("role"), str):
        role = "system" if item["role"] == "developer" else item["role"]
        messages.append({"role": role, "content": text_of(item.get("content"), f"{where}.content")})
    elif kind in ("function_call", "custom_tool_call"):
        function = {
            "name": item.get("name", ""),
            "arguments": item.get("arguments") or json.dumps({"input": item.get("input", "")}),
        }
        call = {"id": item.get("call_id"), "type": "function", "function": function}
        if not messages or messages[-1]["role"] != "assistant":
            messages.append({"role": "assistant", "content": ""})
        messages[-1].setdefault("tool_calls", []).append(call)
    elif kind in ("function_call_output", "custom_tool_call_output"):
        output = text_of(item.get("output"), f"{where}.output")
        messages.append({"role": "tool", "tool_call_id": item.get("call_id"), "content": output})
    elif kind == "reasoning":
        return  # of this server it has no content that the model must see again
    else:
        raise BadRequestError(
            f"{where} is of the type {kind!r}; messages, function calls and their outputs can be read"
        )


def _output(response: Response, number: str) -> list[dict[str, Any]]:
    items: list[dict[str, Any]] = []
    calls = calls_of(response, number)
    if response.reasoning:
        summary = [{"type": "summary_text", "text": response.reasoning}]
        items.append({"id": f"rs_{number}", "type": "reasoning", "summary": summary})
    if response.text or not calls:
        part = {"type": "output_text", "text": response.text, "annotations": [], "logprobs": []}
        items.append(
            {"id": f"msg_{number}", "type": "message", "role": "assistant", "status": "completed", "content": [part]}
        )
    for place, (call_id, name, arguments) in enumerate(calls):
        items.append(
            {
                "id": f"fc_{number}_{place}",
                "type": "function_call",
                "call_id": call_id,
                "name": name,
                "arguments": arguments,
                "status": "completed",
            }
        )
    return items


def reply(asked: Asked, response: Response, number: str) -> dict[str, Any]:
    """Return the body of a reply; see ``Api``."""
    prompt, sampled = usage_of(response, asked)
    cut_off = response.cut_off
    return {
        "id": f"resp_{number}",
        "object": "response",
        "created_at": int(time.time()),
        "status": "incomplete" if cut_off else "completed",
        "incomplete_details": {"reason": "max_output_tokens"} if cut_off else None,
        "error": None,
        "model": response.model or asked.model,
        "output": _output(response, number),
        "parallel_tool_calls": True,
        "tool_choice": "auto",
        "tools": [],
        "usage": {
            "input_tokens": prompt,
            "input_tokens_details": {"cached_tokens": 0},
            "output_tokens": sampled,
            "output_tokens_details": {"reasoning_tokens": 0},
            "total_tokens": prompt + sampled,
        },
    }


def events(asked: Asked, response: Response, number: str) -> Iterator[Event]:
    """Yield the events of a streamed reply; see ``Api``."""
    whole = reply(asked, response, number)
    count = 0

    def event(kind: str, /, **fields: Any) -> Event:
        nonlocal count
        count += 1
        return kind, {"type": kind, "sequence_number": count - 1, **fields}

    begun = {**whole, "status": "in_progress", "incomplete_details": None, "output": [], "usage": None}
    yield event("response.created", response=begun)
    yield event("response.in_progress", response=begun)
    for index, item in enumerate(whole["output"]):
        place = {"item_id": item["id"], "output_index": index}
        if item["type"] == "message":
            (part,) = item["content"]
            yield event(
                "response.output_item.added", output_index=index, item={**item, "status": "in_progress", "content": []}
            )
            yield event("response.content_part.added", **place, content_index=0, part={**part, "text": ""})
            yield event("response.output_text.delta", **place, content_index=0, delta=part["text"], logprobs=[])
            yield event("response.output_text.done", **place, content_index=0, text=part["text"], logprobs=[])
            yield event("response.content_part.done", **place, content_index=0, part=part)
        elif item["type"] == "function_call":
            yield event(
                "response.output_item.added",
                output_index=index,
                item={**item, "status": "in_progress", "arguments": ""},
            )
            yield event("response.function_call_arguments.delta", **place, delta=item["arguments"])
            yield event(
                "response.function_call_arguments.done", **place, arguments=item["arguments"], name=item["name"]
            )
        else:
            yield event("response.output_item.added", output_index=index, item={**item, "summary": []})
        yield event("response.output_item.done", output_index=index, item=item)
    yield event("response.incomplete" if response.cut_off else "response.completed", response=whole)


error = chat.error
