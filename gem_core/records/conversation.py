"""The history of an episode, as text or as chat messages: ``History`` in views, ``Conversation`` from a record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Self, cast

from gem_core.env.observations import is_messages, join_observations, observation_from
from gem_core.records.plain_json import to_plain
from gem_core.types import TERMINAL_STATE, Info, Observation

ChatMessage = dict[str, Any]

CONCAT_WITH_ACTION = "concat_with_action"


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of a history. Its fields are read by name, never unpacked: there may be more of them.

    Args:
        action: The response's text, to the letter.
        feedback: The result of the action, without the state.
        suffix: The state after it.
        tool_calls: Native calls of the response; None without any.
        messages: Chat messages from ``info["messages"]``, if the environment gives any.
    """

    action: str
    feedback: Observation
    suffix: Observation = ""
    tool_calls: list[dict[str, Any]] | None = None
    messages: list[dict[str, Any]] | None = None

    @classmethod
    def of(cls, action: str, observation: Observation, info: Info) -> Self:
        """Return the turn of a response, and of what ``step`` returned for it."""
        feedback, suffix, messages = info.get("feedback"), info.get("suffix"), info.get("messages")
        if not isinstance(feedback, str | list) or not isinstance(suffix, str | list):
            feedback, suffix = observation, ""
        if not isinstance(messages, list) or not all(isinstance(message, Mapping) for message in messages):
            messages = None
        # A plain str: what the server reported about a response is kept by the rollout, not by the history.
        return cls(str(action), feedback, suffix, getattr(action, "tool_calls", None), messages)

    def as_messages(self) -> list[ChatMessage]:
        """Return the response, with those native calls that were answered, and its answers."""
        said: ChatMessage = {"role": "assistant", "content": self.action}
        if self.tool_calls and self.messages:
            said["tool_calls"] = [{**call, "id": call_id(call, place)} for place, call in enumerate(self.tool_calls)]
        return [said, *self.answers()]

    def answers(self) -> list[ChatMessage]:
        """Return what the environment answered: under the ids of native calls, or as the user."""
        if self.messages is not None:
            return [dict(message) for message in self.messages]
        return [{"role": "user", "content": observation_from(self.feedback, self.suffix)}]


def split_observation(observation: Observation, info: Info) -> tuple[Observation, Observation]:
    """Return feedback and suffix of an observation; without both keys in ``info`` all of it is feedback."""
    turn = Turn.of("", observation, info)
    return turn.feedback, turn.suffix


@dataclass
class History:
    """The task and the turns of an episode, and the forms in which they are shown.

    Args:
        task: What the reset gave, as a turn without an action.
        system: Text of the system message; None without one.
        turns: Oldest first; a view may leave out the oldest.
    """

    task: Turn
    system: str | None = None
    turns: list[Turn] = field(default_factory=list)

    def latest(self) -> Observation:
        """Return the newest output, and how things stand now."""
        newest = (self.turns or [self.task])[-1]
        return observation_from(newest.feedback, newest.suffix)

    def outputs(self) -> Observation:
        """Return all outputs, and how things stand now once, at the end."""
        turns = [self.task, *self.turns]
        return join_observations(list(map(attrgetter("feedback"), turns)), turns[-1].suffix)

    def text(self) -> Observation:
        """Return all outputs and actions, and how things stand now once, at the end."""
        pieces = [self.task.feedback]
        for turn in self.turns:
            pieces += [turn.action, *map(_call_as_text, turn.tool_calls or ()), turn.feedback]
        return join_observations(pieces, (self.turns or [self.task])[-1].suffix)

    def messages(self) -> list[ChatMessage]:
        """Return the chat; the list and its messages are the caller's own.

        It is append-only: each answer of the environment keeps its suffix. Where the environment, or a wrapper that is
        no view of ours, keeps the chat itself, its newest list is taken.
        """
        chat: list[Any] = replace(self.task, messages=None).answers()
        if is_messages(self.task.feedback):
            chat = list(self.task.feedback)
        for turn in self.turns:
            if is_messages(turn.feedback):
                chat = list(turn.feedback)
            else:
                chat += turn.as_messages()
        if self.system is not None and not any(message.get("role") in ("system", "developer") for message in chat):
            chat.insert(0, {"role": "system", "content": self.system})
        return [dict(message) for message in chat]


class Conversation:
    """The history of an episode so far, whatever its view: built from its record, each turn when it is needed.

    Args:
        episode: An ``Episode``, which may still be under way.

    ``system`` is the text of the system message, None without one.
    """

    def __init__(self, episode: Any) -> None:
        self._episode = episode
        told = episode.info.get("tool_instructions")
        words: tuple[Any, ...] = (told.get("text"), told.get("native")) if isinstance(told, Mapping) else ()
        self._wordings = words if episode.native_tools and all(isinstance(each, str) for each in words) else ()
        """The explanation of the tools, and the words in its place where an agent is offered them natively."""
        first = episode.observation[0] if is_messages(episode.observation) else {}
        system = episode.info.get("system") if episode.system is None else episode.system
        if first.get("role") == "system":
            system = first.get("content")  # messages that bring their own keep it
        self.system: str | None = self._explained_once(system) if isinstance(system, str) else None
        self._history = History(self._turn("", episode.observation, episode.info), self.system)

    def sent(self) -> Observation:
        """Return what the agent is sent now, according to ``reads`` of the episode."""
        if self._episode.reads == "messages":
            return self.messages()
        if self._episode.reads == CONCAT_WITH_ACTION:
            return self._so_far().text()
        return cast("Observation", self._explained_once(self._episode.final_observation))

    def messages(self) -> list[ChatMessage]:
        """Return the chat so far; the list and its messages are the caller's own."""
        return self._so_far().messages()

    def _so_far(self) -> History:
        episode, turns = self._episode, self._history.turns
        answers = [*(each.observation for each in episode.transitions[len(turns) + 1 :]), episode.final_observation]
        for taken, answer in zip(episode.transitions[len(turns) :], answers, strict=False):
            turn = self._turn(taken.action, answer, taken.info)
            if turn.feedback == TERMINAL_STATE and turn.messages is None:
                turn = replace(turn, messages=[])
            turns.append(turn)
        return self._history

    def _turn(self, action: str, observation: Observation, info: Info) -> Turn:
        turn = Turn.of(action, observation, info)
        viewed = "view" in self._episode.info
        if not viewed and observation_from(turn.feedback, turn.suffix) != observation:
            turn = replace(turn, feedback=observation, suffix="")  # a wrapper that is no view has changed it
        outputs = {name: self._explained_once(getattr(turn, name)) for name in ("feedback", "suffix", "messages")}
        return replace(turn, **outputs) if self._wordings else turn

    def _explained_once(self, observation: Any) -> Any:
        """Return an observation without the explanation of tools if the agent is offered them natively."""
        return _replaced(observation, *self._wordings) if self._wordings and self._wordings[0] else observation


def call_id(call: object, place: int) -> str:
    """Return the id of a native call, or one by its place if it has none, so that it can be answered."""
    given = call.get("id") if isinstance(call, Mapping) else None
    return str(given) if given else f"call_{place}"


def _call_as_text(call: Mapping[str, Any]) -> str:
    """Return a native call as it is written in a text; arguments that are no valid JSON stay as they were written."""
    function = call.get("function")
    if not isinstance(function, Mapping):
        function = {}
    arguments = function.get("arguments") or "{}"
    if not isinstance(arguments, str):
        arguments = json.dumps(to_plain(arguments), ensure_ascii=False)
    name = json.dumps(to_plain(function.get("name", "")), ensure_ascii=False)
    return f'<tool_call>{{"name": {name}, "arguments": {arguments}}}</tool_call>'


def _replaced(observation: Any, text: str, other: str) -> Any:
    """Return an observation, or its parts or messages, with other words in the place of a text."""
    if isinstance(observation, str):
        return observation.replace(text, other)
    if isinstance(observation, list):
        return [_replaced(part, text, other) for part in observation]
    if not isinstance(observation, Mapping):
        return observation
    return {
        name: _replaced(value, text, other) if name in ("text", "content") else value
        for name, value in observation.items()
    }
