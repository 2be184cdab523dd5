"""Views of the history as a chat: a list of messages, or the text that a chat template makes of it."""

from __future__ import annotations

import importlib
from functools import cached_property
from typing import Any, ClassVar, cast

from gem_core.env.spaces import Messages
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.records.conversation import ChatMessage, History, Turn
from gem_core.types import Observation
from gem_core.wrappers.views import ObservationView

_MARK = "GEM-BRIDGE-MARK"
"""Placeholder for a response in a dummy chat, which shows what a template writes after one."""


class MessagesView(ObservationView):
    """Shows the history as a list of chat messages.

    The first is the system's, where ``info["system"]`` of the reset has one, then the task's; then for each turn the
    assistant's, with its native tool calls, and what the environment answers: under the ids of the calls, or as the
    user. As it stands, the view is append-only: each answer of the environment keeps how things stood then.
    """

    can_append_only: ClassVar[bool] = True

    @cached_property
    def observation_space(self) -> Messages:  # type: ignore[override]  # Gymnasium has a property, too
        """Lists of messages."""
        return Messages()

    show = staticmethod(History.messages)


class ConcatChat(ObservationView):
    """Shows the history as the text that a tokenizer's chat template makes of it, ready for the next response.

    As it stands, the view is append-only: the text is the previous one, the response to the letter, and what the
    template writes between a response and the next. Tokens that were sampled are never made anew from text, whatever
    the template does to earlier turns. With a limit, or native tool calls, the whole chat is rendered anew.

    Args:
        env: What is viewed.
        tokenizer: An object with ``apply_chat_template``, as those of transformers; or the name of one to load.
        template_options: More keyword arguments for ``apply_chat_template``, as ``{"enable_thinking": False}``.
        **options: See ``ObservationView``.

    Source: bridging by the difference of two renderings is how verl and prime-rl keep sampled tokens.
    """

    can_append_only: ClassVar[bool] = True
    shared_by_forks = ("tokenizer",)

    def __init__(
        self, env: AnyEnv, tokenizer: Any, *, template_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        self.tokenizer = _load_tokenizer(tokenizer)
        self.template_options = dict(template_options or {})
        super().__init__(env, **options)
        self._text = ""

    def show(self, history: History, /) -> Observation:
        """Return the text of the chat."""
        if not self.append_only or not history.turns or any(turn.tool_calls for turn in history.turns):
            self._text = self._render(history.messages())
        else:
            newest = history.turns[-1]
            self._text += newest.action + self._bridge(newest)
        return self._text

    def _bridge(self, turn: Turn) -> str:
        """Return what the template writes between a response and the next."""
        dummy = [{"role": "user", "content": "…"}, {"role": "assistant", "content": _MARK}]
        rendered = self._render([*dummy, *turn.answers()])
        _, found, bridge = rendered.partition(_MARK)  # the first: what the task says may hold another
        if not found:
            raise ArgumentError("the chat template leaves earlier responses out, so that nothing can follow them")
        end_of_turn = getattr(self.tokenizer, "eos_token", None)
        if end_of_turn and turn.action.endswith(end_of_turn) and bridge.startswith(end_of_turn):
            # Some trainers keep special tokens in the text of a response.
            bridge = bridge[len(end_of_turn) :]
        return bridge

    def _render(self, messages: list[ChatMessage]) -> str:
        text = self.tokenizer.apply_chat_template(
            messages, tokenize=False, add_generation_prompt=True, **self.template_options
        )
        return cast("str", text)


def _load_tokenizer(tokenizer: Any) -> Any:
    if isinstance(tokenizer, str):
        try:
            transformers = importlib.import_module("transformers")
        except ModuleNotFoundError as error:
            raise ArgumentError("loading a tokenizer by name needs transformers: 'pip install transformers'") from error
        return transformers.AutoTokenizer.from_pretrained(tokenizer)
    if not hasattr(tokenizer, "apply_chat_template"):
        raise ArgumentError(f"a tokenizer has apply_chat_template(), and {tokenizer!r:.100} has not")
    return tokenizer
