"""Views of the history as a chat: a list of messages, or the text that a chat template makes of it."""

from __future__ import annotations

import importlib
from typing import Any, ClassVar, cast

from gem_core.env.observations import observation_from
from gem_core.env.spaces import Messages
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.records.conversation import ChatMessage, answer_messages, assistant_message, opening_messages
from gem_core.records.turns import Turn
from gem_core.types import Observation, ResetResult
from gem_core.wrappers.views import ObservationView

_MARK = "GEM-BRIDGE-MARK"
"""Placeholder for a response in a dummy chat, which shows what a template writes after one."""


class MessagesView(ObservationView):
    """Shows the history as a list of chat messages.

    The first is the system's, where there is one, then the task's; then for each turn the assistant's, with its native
    tool calls, and what the environment answers: under the ids of the calls, or as the user.

    As it stands, the view is append-only: each answer of the environment keeps how things stood then.

    Args:
        env: What is viewed.
        system: Text of the system message; by default what the task says in ``info["system"]``, if anything.
        repeat_suffix: Whether every answer keeps how things stood after it; False shows that once, at the end, and the
            view is then not append-only.
        keep_reasoning: Whether the assistant's messages hold ``reasoning_content``, which some servers want back.
        **limits: See ``ObservationView``.
    """

    can_append_only: ClassVar[bool] = True

    def __init__(
        self,
        env: AnyEnv,
        *,
        system: str | None = None,
        repeat_suffix: bool = True,
        keep_reasoning: bool = False,
        **limits: Any,
    ) -> None:
        super().__init__(env, **limits)
        self.system = system
        self.repeat_suffix = repeat_suffix
        self.keep_reasoning = keep_reasoning
        self.observation_space = Messages()
        self._task_system: str | None = None
        self._first_suffix: Observation = ""

    @property
    def append_only(self) -> bool:
        """Whether the next list always is the previous one, the raw response, and more."""
        return self.repeat_suffix and super().append_only

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Begin a new chat."""
        self._task_system = result[1].get("system")
        self._first_suffix = result[1].get("suffix", "") if "feedback" in result[1] else ""
        return super().after_reset(result)

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the messages."""
        return self.messages(task, turns, suffix)

    def messages(self, task: Observation, turns: list[Turn], suffix: Observation) -> list[ChatMessage]:
        """Return the chat so far."""
        system = self.system if self.system is not None else self._task_system
        first_suffix = self._first_suffix if self.repeat_suffix or not turns else ""
        chat = opening_messages(system, observation_from(task, first_suffix))
        for number, turn in enumerate(turns, start=1):
            chat.append(assistant_message(turn, keep_reasoning=self.keep_reasoning))
            chat += answer_messages(turn, with_suffix=self.repeat_suffix or number == len(turns))
        return chat

    def _get_state(self) -> dict[str, Any]:
        if not isinstance(self._first_suffix, str):
            raise StateNotSupported("the task's suffix holds content parts, whose images are not plain data")
        return {**super()._get_state(), "system": self._task_system, "first_suffix": self._first_suffix}

    def _set_state(self, state: dict[str, Any]) -> None:
        super()._set_state(state)
        self._task_system, self._first_suffix = state["system"], state["first_suffix"]


class ConcatChat(MessagesView):
    """Shows the history as the text that a tokenizer's chat template makes of it, ready for the next response.

    As it stands, the view is append-only: the text is the previous one, the response to the letter, and what the
    template writes between a response and the next. Tokens that were sampled are never made anew from text, whatever
    the template does to earlier turns. With a limit, or native tool calls, the whole chat is rendered anew.

    Args:
        env: What is viewed.
        tokenizer: An object with ``apply_chat_template``, as those of transformers; or the name of one to load.
        template_options: More keyword arguments for ``apply_chat_template``, as ``{"enable_thinking": False}``.
        **options: See ``MessagesView``.

    Source: bridging by the difference of two renderings is how verl and prime-rl keep sampled tokens.
    """

    def __init__(
        self, env: AnyEnv, tokenizer: Any, *, template_options: dict[str, Any] | None = None, **options: Any
    ) -> None:
        self.tokenizer = _load_tokenizer(tokenizer)
        self.template_options = dict(template_options or {})
        super().__init__(env, **options)
        self.observation_space = env.observation_space
        self._text = ""
        self._bridged = 0

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Begin a new text."""
        self._text, self._bridged = "", 0
        return super().after_reset(result)

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the text of the chat."""
        if not self.append_only or any(turn.tool_calls for turn in turns):
            return self._render(self.messages(task, turns, suffix))
        if not turns or not self._text:
            self._text, self._bridged = self._render(self.messages(task, [], suffix)), 0
        for turn in turns[self._bridged :]:
            self._text += turn.action + self._bridge(turn)
        self._bridged = len(turns)
        return self._text

    def _bridge(self, turn: Turn) -> str:
        """Return what the template writes between a response and the next."""
        dummy = [{"role": "user", "content": "…"}, {"role": "assistant", "content": _MARK}]
        rendered = self._render([*dummy, *answer_messages(turn)])
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

    def _get_state(self) -> dict[str, Any]:
        return {**super()._get_state(), "text": self._text, "bridged": self._bridged}

    def _set_state(self, state: dict[str, Any]) -> None:
        super()._set_state(state)
        self._text, self._bridged = str(state["text"]), int(state["bridged"])


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
