"""``Turn``: a turn as views and the conversation remember it, and its form as text."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from gem_core.env.observations import join_observations, observation_from
from gem_core.records.plain_json import to_plain
from gem_core.types import Info, Observation, Response


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn as a view remembers it. Its fields are read by name, never unpacked: there may be more of them.

    Args:
        action: The response's text, to the letter.
        feedback: What happened.
        suffix: How things stood after it.
        tool_calls: Native calls of the response; None without any.
        reasoning: Thinking that the server took out of the text; None without any.
        messages: What the environment appends to a chat, where it says so in ``info["messages"]``.
    """

    action: str
    feedback: Observation
    suffix: Observation = ""
    tool_calls: list[dict[str, Any]] | None = None
    reasoning: str | None = None
    messages: list[dict[str, Any]] | None = None

    @classmethod
    def of(cls, action: str, feedback: Observation, suffix: Observation, info: Info) -> Self:
        """Return the turn of a response, and of what ``step`` returned for it."""
        response, messages = Response.of(action), info.get("messages")
        if not isinstance(messages, list) or not all(isinstance(message, Mapping) for message in messages):
            messages = None
        # A plain str: what the server reported about a response is kept by the rollout, not by the view.
        return cls(response.text, feedback, suffix, response.tool_calls, response.reasoning, messages)


def with_actions(task: Observation, turns: Iterable[Turn], suffix: Observation) -> Observation:
    """Return all outputs and actions so far, and how things stand now once, at the end."""
    pieces = [task]
    for turn in turns:
        pieces += [turn.action, *map(_call_as_text, turn.tool_calls or ()), turn.feedback]
    return observation_from(join_observations(pieces), suffix)


def _call_as_text(call: Mapping[str, Any]) -> str:
    """Return a native call as it is written in a text; arguments that are no valid JSON stay as they were written."""
    function = call.get("function", call.get("custom"))
    if not isinstance(function, Mapping):
        function = {}
    arguments = function.get("arguments") or "{}"
    if "input" in function:  # plain text, of a custom tool of the API
        arguments = json.dumps(to_plain(function["input"]), ensure_ascii=False)
    elif not isinstance(arguments, str):
        arguments = json.dumps(to_plain(arguments), ensure_ascii=False)
    name = json.dumps(to_plain(function.get("name", "")), ensure_ascii=False)
    return f'<tool_call>{{"name": {name}, "arguments": {arguments}}}</tool_call>'


def call_id(call: object, place: int) -> str:
    """Return the id of a native call, or one by its place where it has none, so that it can be answered."""
    given = call.get("id") if isinstance(call, Mapping) else None
    return str(given) if given else f"call_{place}"
