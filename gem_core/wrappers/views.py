"""Observation views: how much of the history an agent is shown.

A view keeps a ``History`` and shows it; limits work on its turns, never on rendered text. ``info["feedback"]`` and
``info["suffix"]`` stay as the task wrote them. The chat views are in ``gem_core.wrappers.chat``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from gem_core.env.observations import texts_of
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.parsing import without_thinking
from gem_core.records.conversation import History, Turn
from gem_core.types import Observation, ResetResult, StepResult


class ObservationView(Wrapper):
    """Base class of views: remembers the history, and chooses the part that the agent sees next.

    A subclass overrides ``show``.

    Args:
        env: What is viewed.
        max_turns: Show only this many of the newest turns, after the task itself, which is always shown; None for all.
        drop_thinking: Leave thinking blocks out of the actions of earlier turns.
        max_tokens: Drop the oldest turns while the observation has more tokens than this. When the task and the newest
            turn alone have more, the context overflows: the episode is truncated, with ``info["context_overflow"]``.
        count_tokens: How tokens are counted: a tokenizer with ``encode``, or a function of a text. Images are not.
    """

    can_append_only: ClassVar[bool] = False
    """Whether the view is append-only as long as nothing is dropped."""

    def __init__(
        self,
        env: AnyEnv,
        *,
        max_turns: int | None = None,
        drop_thinking: bool = False,
        max_tokens: int | None = None,
        count_tokens: Any = None,
    ) -> None:
        super().__init__(env)
        for name, limit in (("max_turns", max_turns), ("max_tokens", max_tokens)):
            if limit is not None and (type(limit) is not int or limit < 1):
                raise ArgumentError(f"{name} must be a positive whole number or None, not {limit!r}")
        if max_tokens is not None and count_tokens is None:
            raise ArgumentError("max_tokens needs count_tokens: a tokenizer with encode(), or a function of a text")
        self.max_turns = max_turns
        self.drop_thinking = drop_thinking
        self.max_tokens = max_tokens
        self.count_tokens = count_tokens
        self._history = History(Turn("", ""))

    @property
    def append_only(self) -> bool:
        """Whether the next observation always is the previous one, the raw response, and more."""
        return self.can_append_only and self.max_turns is None and self.max_tokens is None and not self.drop_thinking

    def show(self, history: History, /) -> Observation:
        """Return the observation.

        Args:
            history: The task, and those turns that are to be shown.
        """
        raise NotImplementedError(f"{type(self).__name__} must define show(self, history)")

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Begin a new history."""
        observation, info = result
        task = Turn.of("", observation, info)
        info["feedback"], info["suffix"] = task.feedback, task.suffix  # since the view may show something else
        info["view"] = self.registered_as[0] if self.registered_as else type(self).__name__
        self._history = History(task, info.get("system"))
        shown = self.show(self._history)
        if self.max_tokens is not None and self._is_too_long(shown):
            raise ArgumentError(f"the task alone has more tokens than max_tokens, which is {self.max_tokens}; raise it")
        return shown, info

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Add the turn, drop what is too much, and show the rest."""
        observation, reward, terminated, truncated, info = result
        turn, turns = Turn.of(action, observation, info), self._history.turns
        info["feedback"], info["suffix"] = turn.feedback, turn.suffix
        turns.append(replace(turn, action=without_thinking(turn.action)) if self.drop_thinking else turn)
        if self.max_turns is not None:
            del turns[: -self.max_turns]
        shown = self.show(self._history)
        while self.max_tokens is not None and self._is_too_long(shown):
            if len(turns) == 1:
                info["context_overflow"] = True
                truncated = truncated or not terminated
                break
            del turns[0]
            shown = self.show(self._history)
        return shown, reward, terminated, truncated, info

    def _is_too_long(self, observation: Observation) -> bool:
        text = "\n".join(texts_of(observation))
        encode = getattr(self.count_tokens, "encode", None)
        length = len(encode(text)) if encode is not None else int(self.count_tokens(text))
        return length > (self.max_tokens or 0)


class Latest(ObservationView):
    """Shows only the newest output, and how things stand now."""

    show = staticmethod(History.latest)


class Concat(ObservationView):
    """Shows all outputs so far, and how things stand now once, at the end."""

    show = staticmethod(History.outputs)


class ConcatWithAction(ObservationView):
    """Shows all outputs and actions so far, and how things stand now once, at the end.

    A native tool call is shown as the text that would call the tool.
    """

    show = staticmethod(History.text)
