"""Spaces for text, content parts and chat messages.

``gymnasium.spaces.Text`` lists its characters one by one and refuses ordinary Unicode, hence these. They are equal by
value, so that two instances of one environment have equal spaces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium

_ALPHABET = "abcdefghijklmnopqrstuvwxyz 0123456789 \\{}[]äπ中🙂"


class Text(gymnasium.Space[Any]):
    """Any string at all, of any length.

    Source: ``Space`` of Gymnasium, https://gymnasium.farama.org/api/spaces/.
    """

    def __init__(self, seed: int | None = None) -> None:
        super().__init__(shape=None, dtype=str, seed=seed)

    def sample(self, mask: Any | None = None, probability: Any | None = None) -> str:
        """Return up to 32 random characters; neither a mask nor probabilities mean anything here."""
        length = int(self.np_random.integers(0, 33))
        return "".join(_ALPHABET[int(i)] for i in self.np_random.integers(0, len(_ALPHABET), size=length))

    def contains(self, x: Any) -> bool:
        """Tell whether ``x`` is a string."""
        return isinstance(x, str)

    @property
    def is_np_flattenable(self) -> bool:
        """Text has no fixed shape."""
        return False

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self)

    def __hash__(self) -> int:
        return hash(type(self))

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"


class Content(Text):
    """A list of content parts, as Hugging Face chat templates take them; or a plain string.

    A part is ``{"type": "text", "text": str}`` or ``{"type": "image", "image": PIL.Image.Image}``.
    """

    def contains(self, x: Any) -> bool:
        """Tell whether ``x`` is a string or a list of parts."""
        return isinstance(x, str) or (_is_list(x) and all(is_part(part) for part in x))


class Messages(Text):
    """A list of chat messages, each with a ``role`` and, but for tool calls, ``content``."""

    def sample(self, mask: Any | None = None, probability: Any | None = None) -> Any:
        """Return one message of a user with random text."""
        return [{"role": "user", "content": super().sample()}]

    def contains(self, x: Any) -> bool:
        """Tell whether ``x`` is a list of messages."""
        return _is_list(x) and all(isinstance(message, Mapping) and "role" in message for message in x)


def is_part(part: object) -> bool:
    """Tell whether an object is one content part."""
    if not isinstance(part, Mapping):
        return False
    kind = part.get("type")
    return (kind == "text" and isinstance(part.get("text"), str)) or (kind == "image" and "image" in part)


def _is_list(x: object) -> bool:
    return isinstance(x, Sequence) and not isinstance(x, str | bytes)
