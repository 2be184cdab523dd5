"""``Conversation``: an episode as chat messages or as text, regardless of its view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from gem_core.env.observations import is_messages, observation_from, split_observation
from gem_core.records.turns import Turn, call_id, with_actions
from gem_core.types import TERMINAL_STATE, Info, Observation, Response

ChatMessage = dict[str, Any]

CONCAT_WITH_ACTION = "concat_with_action"


class Turned(Protocol):
    """The attributes of a transition that the conversation uses."""

    observation: Observation
    action: Response
    info: Info


class Recorded(Protocol):
    """The attributes of an ``Episode`` that the conversation uses."""

    observation: Observation
    info: Info
    final_observation: Observation
    reads: str | None
    system: str | None
    native_tools: bool

    @property
    def transitions(self) -> Sequence[Turned]:
        """The turns so far, oldest first."""


class Conversation:
    """The conversation of an episode so far, built from its record; each turn is read once, when it is needed.

    The messages are append-only: each answer of the environment keeps its suffix.

    Args:
        episode: It may still be under way.

    ``system`` is the text of the system message, None without one.
    """

    def __init__(self, episode: Recorded) -> None:
        self._episode = episode
        # Records of earlier versions do not say what was sent; they may have had a view.
        self._viewed = "view" in episode.info or episode.reads is None
        self._instructions = self._in_both_wordings()
        self.system = self._system()
        self._task, self._suffix = self._split(episode.observation, episode.info)
        self._turns: list[Turn] = []
        self._chat = self._opening()

    def sent(self) -> Observation:
        """Return what the agent is sent now, according to ``reads`` of the episode."""
        episode = self._episode
        if episode.reads == "messages":
            return self.messages()
        newest = self.text() if episode.reads == CONCAT_WITH_ACTION else episode.final_observation
        shown: Observation = self._explained_once(newest)
        return shown

    def messages(self) -> list[ChatMessage]:
        """Return the chat so far; the list and its messages are the caller's own."""
        self._catch_up()
        return [dict(message) for message in self._chat]

    def text(self) -> Observation:
        """Return all outputs and actions so far, as the view ``concat_with_action`` shows them."""
        self._catch_up()
        return with_actions(self._task, self._turns, self._suffix)

    def _catch_up(self) -> None:
        transitions = self._episode.transitions
        for place in range(len(self._turns), len(transitions)):
            taken = transitions[place]
            is_last = place + 1 == len(transitions)
            observation = self._episode.final_observation if is_last else transitions[place + 1].observation
            feedback, self._suffix = self._split(observation, taken.info)
            turn = Turn.of(taken.action, feedback, self._suffix, taken.info)
            self._turns.append(turn)
            if is_messages(feedback):
                self._chat = _with_system(self._explained_once(feedback), self.system)
            elif feedback == TERMINAL_STATE and turn.messages is None:
                self._chat.append(assistant_message(turn))
            else:
                self._chat += [assistant_message(turn), *self._explained_once(answer_messages(turn))]

    def _opening(self) -> list[ChatMessage]:
        task = self._explained_once(self._task)
        if is_messages(task):  # the environment, or a wrapper that is no view of ours, keeps the chat itself
            return _with_system(task, self.system)
        return opening_messages(self.system, observation_from(task, self._suffix))

    def _explained_once(self, observation: Any) -> Any:
        """Return a text without the explanation of tools if the agent is offered them natively."""
        return observation if self._instructions is None else _in_native_words(observation, *self._instructions)

    def _in_both_wordings(self) -> tuple[str, str] | None:
        told = self._episode.info.get("tool_instructions")
        if not self._episode.native_tools or not isinstance(told, Mapping):
            return None
        text, native = told.get("text"), told.get("native")
        return (text, native) if text and isinstance(text, str) and isinstance(native, str) else None

    def _system(self) -> str | None:
        episode = self._episode
        first = episode.observation[0] if is_messages(episode.observation) else {}
        system: Any = episode.info.get("system") if episode.system is None else episode.system
        if isinstance(first, Mapping) and first.get("role") == "system":
            system = first.get("content")  # messages that bring their own keep it
        return self._explained_once(system) if isinstance(system, str) else None

    def _split(self, observation: Observation, info: Info) -> tuple[Observation, Observation]:
        feedback, suffix = split_observation(observation, info)
        if self._viewed or observation_from(feedback, suffix) == observation:
            return feedback, suffix
        return observation, ""  # a wrapper that is no view has changed it


def opening_messages(system: str | None, task: Observation) -> list[ChatMessage]:
    """Return the messages with which a chat begins."""
    return _with_system([{"role": "user", "content": task}], system)


def assistant_message(turn: Turn, *, keep_reasoning: bool = False) -> ChatMessage:
    """Return a response as a message, with those native calls that were answered."""
    message: ChatMessage = {"role": "assistant", "content": turn.action}
    if turn.tool_calls and turn.messages is not None:
        message["tool_calls"] = [{**call, "id": call_id(call, place)} for place, call in enumerate(turn.tool_calls)]
    if keep_reasoning and turn.reasoning:
        message["reasoning_content"] = turn.reasoning
    return message


def answer_messages(turn: Turn, *, with_suffix: bool = True) -> list[ChatMessage]:
    """Return what the environment answered: under the ids of native calls, or as the user."""
    if turn.messages is not None:
        return [dict(message) for message in turn.messages]
    return [{"role": "user", "content": observation_from(turn.feedback, turn.suffix if with_suffix else "")}]


def _with_system(messages: Observation, system: str | None) -> list[ChatMessage]:
    chat = [dict(message) for message in messages if isinstance(message, dict)]
    if system is not None and not any(message.get("role") in ("system", "developer") for message in chat):
        chat.insert(0, {"role": "system", "content": system})
    return chat


def _in_native_words(observation: Any, text: str, native: str) -> Any:
    """Return an observation whose explanation of tools is replaced by what native calls need of it."""
    if isinstance(observation, str):
        return observation.replace(text, native)
    return [
        {**part, **{name: _in_native_words(part[name], text, native) for name in _holders_of_text(part)}}
        if isinstance(part, Mapping)
        else part
        for part in observation
    ]


def _holders_of_text(part: Mapping[str, Any]) -> list[str]:
    return [name for name in ("text", "content") if isinstance(part.get(name), str | list)]
