"""Observation views: how much of the history an agent is shown.

A view keeps the list of turns and renders it; limits work on that list, never on rendered text. ``info["feedback"]``
and ``info["suffix"]`` stay as the task wrote them. The chat views are in ``gem_core.wrappers.chat``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, ClassVar

from gem_core.env.observations import join_observations, observation_from, split_observation, texts_of
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.parsing import without_thinking
from gem_core.records.turns import Turn, with_actions
from gem_core.types import Info, Observation, ResetResult, StepResult

Summarizer = Callable[[str, list[Turn]], str]
"""Called with the summary so far and the turns to be dropped next; returns the new summary."""


class ObservationView(Wrapper):
    """Base class of views: remembers the turns, and decides what the agent is shown next.

    A subclass overrides ``show``.

    Args:
        env: What is viewed.
        max_turns: Show only this many of the newest turns, after the task itself, which is always shown; None for all.
        drop_thinking: Leave thinking blocks out of the actions of earlier turns.
        thinking_tag: Name of the tag around thinking.
        max_tokens: Drop the oldest turns while the observation has more tokens than this. When the task and the newest
            turn alone have more, the context overflows: the episode is truncated, with ``info["context_overflow"]``.
        count_tokens: How tokens are counted: a tokenizer with ``encode``, or a function of a text. Images are not.
        summarize: Called with the summary so far and the turns that are dropped next; what it returns is shown after
            the task instead of them.
    """

    can_append_only: ClassVar[bool] = False
    """Whether the view is append-only as long as nothing is dropped."""

    def __init__(
        self,
        env: AnyEnv,
        *,
        max_turns: int | None = None,
        drop_thinking: bool = False,
        thinking_tag: str = "think",
        max_tokens: int | None = None,
        count_tokens: Any = None,
        summarize: Summarizer | None = None,
    ) -> None:
        super().__init__(env)
        for name, limit in (("max_turns", max_turns), ("max_tokens", max_tokens)):
            if limit is not None and (type(limit) is not int or limit < 1):
                raise ArgumentError(f"{name} must be a positive whole number or None, not {limit!r}")
        if max_tokens is not None and count_tokens is None:
            raise ArgumentError("max_tokens needs count_tokens: a tokenizer with encode(), or a function of a text")
        if summarize is not None and max_turns is None and max_tokens is None:
            raise ArgumentError("summarize needs max_turns or max_tokens, which say what is dropped")
        self.max_turns = max_turns
        self.drop_thinking = drop_thinking
        self.thinking_tag = thinking_tag
        self.max_tokens = max_tokens
        self.count_tokens = count_tokens
        self.summarize = summarize
        if summarize is not None:
            self.needs = "thread"
        self._begin("", "")

    @property
    def append_only(self) -> bool:
        """Whether the next observation always is the previous one, the raw response, and more."""
        return self.can_append_only and self.max_turns is None and self.max_tokens is None and not self.drop_thinking

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the observation.

        Args:
            task: What the reset said, and the summary of what is left out.
            turns: The turns that are to be shown, oldest first.
            suffix: How things stand now; shown once, at the end.
        """
        raise NotImplementedError(f"{type(self).__name__} must define show(self, task, turns, suffix)")

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Begin a new list of turns."""
        observation, info = result
        self._begin(*_split(observation, info))
        info["view"] = self.made_as[0] if self.made_as else type(self).__name__
        shown = self._shown()
        if self._is_too_long(shown):
            raise ArgumentError(
                f"the task alone has {self._length(shown)} tokens, and max_tokens is {self.max_tokens}; raise it"
            )
        return shown, info

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Add the turn and render the list."""
        observation, reward, terminated, truncated, info = result
        feedback, self._suffix = _split(observation, info)
        turn = Turn.of(action, feedback, self._suffix, info)
        if self.drop_thinking:
            turn = replace(turn, action=without_thinking(turn.action, self.thinking_tag), reasoning=None)
        self._turns.append(turn)
        shown = self._fit_turns()
        if self._is_too_long(shown):
            info["context_overflow"] = True
            truncated = truncated or not terminated
        return shown, reward, terminated, truncated, info

    def _begin(self, task: Observation, suffix: Observation) -> None:
        self._task, self._suffix = task, suffix
        self._turns: list[Turn] = []
        self._dropped = 0
        self._summary = ""

    def _fit_turns(self) -> Observation:
        """Drop turns until the rest fits, and return what is shown."""
        count = len(self._turns)
        wanted = 0 if self.max_turns is None else count - self.max_turns
        while True:
            self._drop(max(wanted, self._dropped))
            shown = self._shown()
            if not self._is_too_long(shown) or self._dropped >= count - 1:
                return shown
            wanted = self._dropped + 1

    def _drop(self, count: int) -> None:
        if count > self._dropped:
            if self.summarize is not None:
                self._summary = self.summarize(self._summary, self._turns[self._dropped : count])
            self._dropped = count

    def _shown(self) -> Observation:
        task = self._task
        if self._summary:
            task = join_observations([task, f"Summary of the earlier turns:\n{self._summary}\n"])
        return self.show(task, self._turns[self._dropped :], self._suffix)

    def _is_too_long(self, observation: Observation) -> bool:
        return self.max_tokens is not None and self._length(observation) > self.max_tokens

    def _length(self, observation: Observation) -> int:
        text = "\n".join(texts_of(observation))
        encode = getattr(self.count_tokens, "encode", None)
        return len(encode(text)) if encode is not None else int(self.count_tokens(text))

    def _get_state(self) -> dict[str, Any]:
        outputs = [self._task, self._suffix]
        for turn in self._turns:
            outputs += [turn.feedback, turn.suffix, *(m.get("content") or "" for m in turn.messages or ())]
        if not all(isinstance(output, str) for output in outputs):
            raise StateNotSupported(f"{type(self).__name__} holds content parts, whose images are not plain data")
        return {
            "task": self._task,
            "turns": [asdict(turn) for turn in self._turns],
            "suffix": self._suffix,
            "dropped": self._dropped,
            "summary": self._summary,
        }

    def _set_state(self, state: dict[str, Any]) -> None:
        self._task, self._suffix = state["task"], state["suffix"]
        self._turns = [Turn(**turn) for turn in state["turns"]]
        self._dropped, self._summary = int(state["dropped"]), str(state["summary"])


class Latest(ObservationView):
    """Shows only the newest output, and how things stand now."""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the newest feedback and the suffix."""
        return observation_from(turns[-1].feedback if turns else task, suffix)


class Concat(ObservationView):
    """Shows all outputs so far, and how things stand now once, at the end."""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the feedback of every turn and the suffix."""
        return observation_from(join_observations([task, *(turn.feedback for turn in turns)]), suffix)


class ConcatWithAction(ObservationView):
    """Shows all outputs and actions so far, and how things stand now once, at the end.

    A native tool call is shown as the text that would call the tool.
    """

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return action and feedback of every turn, and the suffix."""
        return with_actions(task, turns, suffix)


def _split(observation: Observation, info: Info) -> tuple[Observation, Observation]:
    """Split an observation, and write both parts to ``info``, since the view may show something else."""
    info["feedback"], info["suffix"] = split_observation(observation, info)
    return info["feedback"], info["suffix"]
