"""The OpenAI Chat Completions API: ``POST /v1/chat/completions``.

Source: https://platform.openai.com/docs/api-reference/chat; token ids are vLLM's addition (``return_token_ids``).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

from gem_core import Response
from gem_server.asked import Asked, BadRequestError, Event, calls_of, text_of, usage_of

_SAMPLING = (
    "temperature", "top_p", "max_tokens", "max_completion_tokens", "stop", "seed", "n", "tool_choice",
    "parallel_tool_calls", "response_format", "frequency_penalty", "presence_penalty", "logprobs", "return_token_ids",
)  # fmt: skip


def read(body: Mapping[str, Any]) -> Asked:
    """Return what a request asks; see ``Api``."""
    given = body.get("messages")
    if not isinstance(given, list) or not given:
        raise BadRequestError("messages must be a list with at least one message")
    messages = []
    for place, message in enumerate(given):
        where = f"messages[{place}]"
        if not isinstance(message, Mapping) or not isinstance(message.get("role"), str):
            raise BadRequestError(f"{where} must be an object with a role")
        read_one: dict[str, Any] = {
            "role": message["role"],
            "content": text_of(message.get("content"), f"{where}.content"),
        }
        for name in ("tool_calls", "tool_call_id", "name", "reasoning_content"):
            if message.get(name) is not None:
                read_one[name] = message[name]
        messages.append(read_one)
    if body.get("n") not in (None, 1):
        raise BadRequestError("n must be 1: an episode has one reply to a request")
    tools = body.get("tools") or []
    if not isinstance(tools, list):
        raise BadRequestError("tools must be a list")
    stream_options = body.get("stream_options")
    return Asked(
        messages,
        tools,
        str(body.get("model") or ""),
        bool(body.get("stream")),
        {name: body[name] for name in _SAMPLING if body.get(name) is not None},
        isinstance(stream_options, Mapping) and bool(stream_options.get("include_usage")),
    )


def _message(response: Response, number: str) -> dict[str, Any]:
    calls = [
        {"id": call_id, "type": "function", "function": {"name": name, "arguments": arguments}}
        for call_id, name, arguments in calls_of(response, number)
    ]
    message: dict[str, Any] = {"role": "assistant", "content": response.text or (None if calls else "")}
    if response.reasoning is not None:
        message["reasoning_content"] = response.reasoning
    if calls:
        message["tool_calls"] = calls
    return message


def _finish(response: Response) -> str:
    return "tool_calls" if response.tool_calls else response.finish_reason or "stop"


def _usage(asked: Asked, response: Response) -> dict[str, int]:
    prompt, reply = usage_of(response, asked)
    return {"prompt_tokens": prompt, "completion_tokens": reply, "total_tokens": prompt + reply}


def reply(asked: Asked, response: Response, number: str) -> dict[str, Any]:
    """Return the body of a reply; see ``Api``."""
    choice: dict[str, Any] = {"index": 0, "message": _message(response, number), "finish_reason": _finish(response)}
    body = {
        "id": f"chatcmpl-{number}",
        "object": "chat.completion",
        "created": int(time.time()),
        "model": response.model or asked.model,
        "choices": [choice],
        "usage": _usage(asked, response),
    }
    if asked.sampling.get("return_token_ids") and response.token_ids is not None:
        choice["token_ids"] = response.token_ids
        body["prompt_token_ids"] = response.prompt_token_ids
    return body


def events(asked: Asked, response: Response, number: str) -> Iterator[Event]:
    """Yield the events of a streamed reply; see ``Api``."""
    base = {
        "id": f"chatcmpl-{number}",
        "object": "chat.completion.chunk",
        "created": int(time.time()),
        "model": response.model or asked.model,
    }

    def chunk(delta: dict[str, Any], finish: str | None = None) -> Event:
        return None, {**base, "choices": [{"index": 0, "delta": delta, "finish_reason": finish}]}

    message = _message(response, number)
    calls = message.pop("tool_calls", [])
    yield chunk({name: value for name, value in message.items() if value is not None})
    for place, call in enumerate(calls):
        yield chunk({"tool_calls": [{"index": place, **call}]})
    yield chunk({}, _finish(response))
    if asked.with_usage:
        yield None, {**base, "choices": [], "usage": _usage(asked, response)}
    yield None, "[DONE]"


def error(status: int, message: str) -> dict[str, Any]:
    """Return the body of an error; see ``Api``."""
    kinds = {401: "authentication_error", 404: "not_found_error", 410: "invalid_request_error", 429: "rate_limit_error"}
    kind = kinds.get(status, "server_error" if status >= 500 else "invalid_request_error")
    return {"error": {"message": message, "type": kind, "param": None, "code": None}}
