"""The OpenAI chat format: observations become messages, and completions become responses.

Whatever a server sends, reading it never fails for want of a field: what is missing or has another type is None.

Source: OpenAI's chat API, and what vLLM adds to it (``token_ids``, ``prompt_token_ids``, ``reasoning``).
"""

from __future__ import annotations

import base64
import io
import json
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.env.observations import is_messages
from gem_core.records.plain_json import image_name, is_deep
from gem_core.types import Observation, Response

_PNG_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "I;16")

_encoded: dict[str, str] = {}
"""Images as addresses, by the hash of what they show, for as long as they live."""


def messages_from(observation: Observation, system: str | None = None) -> list[dict[str, Any]]:
    """Return the messages that show an observation to a model.

    Args:
        observation: Text and content parts become one message of the user; a list of messages is sent as it is.
        system: System prompt; put first unless the observation brings one.
    """
    if is_messages(observation):
        messages = _with_images_behind(
            [_with_plain_content(message) for message in observation if isinstance(message, dict)]
        )
    else:
        messages = [{"role": "user", "content": _content(observation)}]
    if system is not None and not any(message.get("role") in ("system", "developer") for message in messages):
        messages.insert(0, {"role": "system", "content": system})
    return messages


def has_images(observation: Observation) -> bool:
    """Tell whether images have to be encoded, which takes milliseconds each."""
    if isinstance(observation, str):
        return False
    contents = [m.get("content") for m in observation] if is_messages(observation) else [observation]
    return any(
        isinstance(part, Mapping) and part.get("type") == "image"
        for content in contents
        if isinstance(content, list)
        for part in content
    )


def response_from(completion: Mapping[str, Any]) -> Response | None:
    """Return the first choice of a completion as a response; None when there is none."""
    choices = completion.get("choices")
    choice = choices[0] if isinstance(choices, list) and choices else None
    if not isinstance(choice, dict) or not isinstance(choice.get("message"), dict):
        return None
    message = choice["message"]
    token_ids = _numbers(choice.get("token_ids"), int)
    logprobs = _logprobs(choice.get("logprobs"))
    if token_ids is not None and logprobs is not None and len(token_ids) != len(logprobs):
        logprobs = None  # which token each belongs to cannot be told
    return Response(
        _text(message.get("content")) or _text(message.get("refusal")),
        token_ids=token_ids,
        prompt_token_ids=_numbers(completion.get("prompt_token_ids"), int),
        logprobs=logprobs,
        finish_reason=_text_or_none(choice.get("finish_reason")),
        tool_calls=_tool_calls(message.get("tool_calls")),
        reasoning=_text_or_none(message.get("reasoning")) or _text_or_none(message.get("reasoning_content")),
        usage=_usage(completion.get("usage")),
        model=_text_or_none(completion.get("model")),
    )


class JoinedStream:
    """Joins the chunks of a stream into the completion that would have come without streaming.

    ``finished`` says whether the model had come to its end; a stream that closes before was cut.
    """

    def __init__(self) -> None:
        self.finished = False
        self._message: dict[str, Any] = {"role": "assistant", "content": None}
        self._choice: dict[str, Any] = {"index": 0, "message": self._message, "finish_reason": None}
        self._calls: dict[int, dict[str, Any]] = {}
        self._completion: dict[str, Any] = {"choices": [self._choice]}

    def add(self, chunk: Mapping[str, Any]) -> None:
        """Take in one chunk."""
        for name in ("id", "model", "prompt_token_ids", "usage"):
            if chunk.get(name) is not None:
                self._completion[name] = chunk[name]
        choices = chunk.get("choices")
        choice = choices[0] if isinstance(choices, list) and choices else None
        if not isinstance(choice, dict) or choice.get("index", 0) != 0:
            return
        if isinstance(choice.get("finish_reason"), str):
            self._choice["finish_reason"] = choice["finish_reason"]
            self.finished = True
        if isinstance(choice.get("token_ids"), list):
            self._choice.setdefault("token_ids", []).extend(choice["token_ids"])
        logprobs = choice.get("logprobs")
        if isinstance(logprobs, dict) and isinstance(logprobs.get("content"), list):
            self._choice.setdefault("logprobs", {"content": []})["content"].extend(logprobs["content"])
        if isinstance(choice.get("delta"), dict):
            self._add_delta(choice["delta"])

    def completion(self) -> dict[str, Any]:
        """Return what was joined so far."""
        if self._calls:
            self._message["tool_calls"] = [self._calls[index] for index in sorted(self._calls)]
        return self._completion

    def _add_delta(self, delta: Mapping[str, Any]) -> None:
        for name in ("content", "refusal", "reasoning", "reasoning_content"):
            if isinstance(delta.get(name), str):
                self._message[name] = (self._message.get(name) or "") + delta[name]
        calls = delta.get("tool_calls")
        for place, piece in enumerate(calls if isinstance(calls, list) else ()):
            if not isinstance(piece, dict):
                continue
            index = piece.get("index", place)
            empty = {"id": None, "type": "function", "function": {"name": "", "arguments": ""}}
            call = self._calls.setdefault(index if isinstance(index, int) else place, empty)
            if isinstance(piece.get("id"), str):
                call["id"] = piece["id"]
            function = piece.get("function")
            for name in ("name", "arguments"):
                if isinstance(function, dict) and isinstance(function.get(name), str):
                    call["function"][name] += function[name]


def _with_plain_content(message: Mapping[str, Any]) -> dict[str, Any]:
    content = message.get("content")
    return {**message, "content": _content(content)} if isinstance(content, list) else dict(message)


def _with_images_behind(messages: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Move the images of tools into a message of the user behind them: the API takes only text in those of tools."""
    moved: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    for message in [*messages, {}]:
        if images and message.get("role") != "tool":
            moved.append({"role": "user", "content": images})
            images = []
        if message.get("role") == "tool" and isinstance(message.get("content"), list):
            found = [part for part in message["content"] if part.get("type") == "image_url"]
            rest = [part for part in message["content"] if part.get("type") != "image_url"]
            if found:
                images += found
                message = {**message, "content": rest or "(an image, shown below)"}
        moved.append(message)
    return moved[:-1]


def _content(content: Observation) -> str | list[dict[str, Any]]:
    return content if isinstance(content, str) else [_part(part) for part in content]


def _part(part: Any) -> dict[str, Any]:
    if not isinstance(part, Mapping):
        return {"type": "text", "text": str(part)}
    if part.get("type") != "image" or "image" not in part:
        return dict(part)
    image = part["image"]
    return {"type": "image_url", "image_url": {"url": image if isinstance(image, str) else _data_url(image)}}


def _data_url(image: Any) -> str:
    # A conversation shows an image in each of its later requests; to encode it takes ten times as long as to hash.
    name = image_name(image)
    url = _encoded.get(name)
    if url is None:
        buffer = io.BytesIO()
        (image if image.mode in _PNG_MODES else image.convert("RGB")).save(buffer, format="PNG")
        url = f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
        _encoded[name] = url
        weakref.finalize(image, _encoded.pop, name, None).atexit = False
    return url


def _text(content: Any) -> str:
    if isinstance(content, list):  # some servers answer in parts
        return "".join(_text(part.get("text")) for part in content if isinstance(part, dict))
    return content if isinstance(content, str) else ""


def _text_or_none(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _usage(usage: Any) -> dict[str, Any] | None:
    return usage if isinstance(usage, dict) and not is_deep(usage) else None


def _numbers(values: Any, kind: type | tuple[type, ...]) -> list[Any] | None:
    if not isinstance(values, list):
        return None
    return values if all(isinstance(value, kind) and not isinstance(value, bool) for value in values) else None


def _logprobs(logprobs: Any) -> list[float] | None:
    entries = logprobs.get("content") if isinstance(logprobs, dict) else None
    if not isinstance(entries, list):
        return None
    values = _numbers([entry.get("logprob") if isinstance(entry, dict) else None for entry in entries], (int, float))
    return None if values is None else [float(value) for value in values]


def _tool_calls(calls: Any) -> list[dict[str, Any]] | None:
    """Return the calls in the form in which they can be sent back; what is wrong inside is answered by the tools."""
    found = []
    for place, call in enumerate(calls if isinstance(calls, Sequence) else ()):
        function = call.get("function") if isinstance(call, dict) else None
        if not isinstance(function, dict):
            continue
        arguments = function.get("arguments")
        if not isinstance(arguments, str):
            arguments = "" if arguments is None else json.dumps(arguments)
        name = function.get("name")
        if is_deep(call):  # no record could hold it
            call, function = {"id": call.get("id")}, {}
        found.append(
            {
                **call,
                "id": call["id"] if isinstance(call.get("id"), str) and call["id"] else f"call_{place}",
                "type": "function",
                "function": {**function, "name": name if isinstance(name, str) else "", "arguments": arguments},
            }
        )
    return found or None
