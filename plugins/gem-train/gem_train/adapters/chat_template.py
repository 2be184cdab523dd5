"""``ChatTemplate``: a tokenizer's chat template, and what it writes between a response and the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from gem_core.errors import ArgumentError
from gem_train.text import encodable

Message = dict[str, Any]

_MARK = "GEM-RESPONSE-MARK"
"""Takes the place of a response in a rendering, which shows what the template writes before and after one."""

_DUMMY_TOOL = {
    "type": "function",
    "function": {
        "name": "dummy",
        "description": "A tool that shows whether a template describes tools.",
        "parameters": {"type": "object", "properties": {}},
    },
}


class ChatTemplate:
    """A tokenizer's chat template.

    Args:
        tokenizer: One of transformers, with a chat template; or an object with ``apply_chat_template``, ``encode``,
            ``decode``, ``all_special_ids`` and ``all_special_tokens`` that work as theirs do.
        **kwargs: More keyword arguments for the template, as ``enable_thinking=False``.

    Raises:
        ArgumentError: The template leaves responses out, so that nothing can follow one.

    ``describes_tools`` says whether the template tells a model about tools.
    """

    def __init__(self, tokenizer: Any, **kwargs: Any) -> None:
        self.tokenizer = tokenizer
        self._kwargs = kwargs
        self._special_ids = frozenset(tokenizer.all_special_ids)
        question = [{"role": "user", "content": "?"}]
        if _MARK not in self.render([*question, {"role": "assistant", "content": _MARK}, *question]):
            raise ArgumentError("the chat template leaves earlier responses out, so that nothing can follow them")
        self.describes_tools = self.render(question) != self.render(question, [_DUMMY_TOOL])

    def render(self, messages: Sequence[Message], tools: Any = None) -> str:
        """Return the text that a model is sent, ready for its next response."""
        text = self.tokenizer.apply_chat_template(
            list(messages), tools=tools or None, tokenize=False, add_generation_prompt=True, **self._kwargs
        )
        return cast("str", text)

    def bridge(self, messages: Sequence[Message], place: int, tools: Any = None) -> str | None:
        """Return what the template writes after the response at a place: the end of its turn, and all that follows.

        Returns:
            The text; None where the template rewrites what came before, so that the chat has to be rendered anew.
        """
        text = messages[place]["content"]
        before, now = self.render(messages[:place], tools), self.render(messages, tools)
        if now.startswith(before + text):
            return now[len(before) + len(text) :]
        marked = self.render([*messages[:place], {**messages[place], "content": _MARK}, *messages[place + 1 :]], tools)
        if not marked.startswith(before + _MARK):
            return None
        bridge = marked[len(before) + len(_MARK) :]
        # Many templates strip white space from a response, which is no reason to give up its tokens.
        return bridge if _without_space(now) == _without_space(before + text + bridge) else None

    def encode(self, text: str) -> list[int]:
        """Return the tokens of a rendered text."""
        return list(self.tokenizer.encode(encodable(text), add_special_tokens=False))

    def decode(self, ids: Sequence[int]) -> str:
        """Return the text of a sampled response, without the token that ended its turn."""
        said = ids[:-1] if self.ended(ids) else ids
        text = self.tokenizer.decode(list(said), skip_special_tokens=False, clean_up_tokenization_spaces=False)
        return cast("str", text)

    def ended(self, ids: Sequence[int]) -> bool:
        """Tell whether the last sampled token is a special one, which ends a turn and is no part of the text."""
        return bool(ids) and ids[-1] in self._special_ids

    def split_end(self, text: str) -> tuple[str, str]:
        """Split a response that was decoded with special tokens into its text and the token that ended its turn.

        The second is empty where the response was cut off. ``bridge.removeprefix(end)`` then follows the response.
        """
        end = max((token for token in self.tokenizer.all_special_tokens if text.endswith(token)), key=len, default="")
        return text.removesuffix(end), end

    def follow(self, ids: Sequence[int], bridge: str) -> list[int]:
        """Return the tokens that a bridge adds to a sampled response, which may have ended its turn itself."""
        added = self.encode(bridge)
        return added[1:] if self.ended(ids) and added[:1] == [ids[-1]] else added


def _without_space(text: str) -> str:
    return "".join(text.split())
