"""Split, join and distinguish observations: text, content parts or chat messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.types import Observation


def observation_from(feedback: Observation, suffix: Observation) -> Observation:
    """Join feedback (what happened) and suffix (the present state) into one observation.

    Text is joined as it is; once one of the two is a list of content parts, both become parts.
    """
    if isinstance(feedback, str) and isinstance(suffix, str):
        return feedback + suffix
    return as_parts(feedback) + as_parts(suffix)


def as_parts(observation: Observation) -> list[dict[str, Any]]:
    """Return an observation as a list of content parts; empty text gives no part."""
    if isinstance(observation, str):
        return [{"type": "text", "text": observation}] if observation else []
    return list(observation)


def join_observations(pieces: Sequence[Observation], suffix: Observation = "") -> Observation:
    """Join outputs and actions, each beginning on a line of its own; parts once there is one list of parts.

    Args:
        pieces: Oldest first.
        suffix: Text after the last piece.
    """
    if not isinstance(suffix, str):
        return as_parts(join_observations(pieces)) + suffix
    text = ""
    for piece in pieces:
        if not isinstance(piece, str):
            return _join_as_parts(pieces) + as_parts(suffix)
        text += f"\n{piece}" if piece and text and not text.endswith("\n") else piece
    return text + suffix


def _join_as_parts(pieces: Sequence[Observation]) -> list[dict[str, Any]]:
    parts: list[dict[str, Any]] = []
    for added in filter(None, map(as_parts, pieces)):
        last = parts[-1] if parts else {}
        if last.get("type") == "text" and not str(last.get("text", "")).endswith("\n"):
            parts[-1] = {**last, "text": f"{last.get('text', '')}\n"}
        parts += added
    return parts


def texts_of(observation: Observation) -> list[str]:
    """Return every text of an observation: of text itself, of content parts, or of messages with their calls."""
    if isinstance(observation, str):
        return [observation]
    texts = []
    for part in observation:
        if part.get("type") == "text":
            texts.append(str(part["text"]))
            continue
        if part.get("content"):
            texts += texts_of(part["content"])
        if part.get("reasoning_content"):
            texts.append(str(part["reasoning_content"]))
        for call in part.get("tool_calls") or ():
            called = call.get("function")
            texts += map(str, called.values() if isinstance(called, dict) else ())
    return texts


def is_messages(observation: Observation) -> bool:
    """Tell a list of messages from content parts."""
    return (
        isinstance(observation, list)
        and bool(observation)
        and all(isinstance(message, Mapping) and "role" in message for message in observation)
    )
