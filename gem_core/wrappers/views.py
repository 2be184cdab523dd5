"""Observation views: how much of the history an agent is shown.

A view keeps the list of turns and renders it; limits work on that list, never on rendered text. ``info["feedback"]``
and ``info["suffix"]`` stay as the task wrote them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from gem_core.env import as_parts, observation_from
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.types import Observation, ResetResult, StepResult
from gem_core.wrapper import AnyEnv, Wrapper


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of the history, as a view shows it.

    Its fields are read by name, never unpacked: views of chat messages will need more of them.

    Args:
        action: What the agent wrote, without its thinking where that is dropped.
        feedback: What happened then.
    """

    action: str
    feedback: Observation


class ObservationView(Wrapper):
    """Base of the views: remembers what was shown and answered, and says what to show next.

    A subclass overrides ``show``.

    Args:
        env: What is viewed.
        max_turns: Show only this many of the newest turns, after the task itself, which is always shown; None for all.
        drop_thinking: Leave thinking blocks out of the actions of earlier turns.
        thinking_tag: Name of the tag around thinking.
    """

    append_only: ClassVar[bool] = False
    """Whether the next observation always is the previous one, the raw response, and more."""

    def __init__(
        self,
        env: AnyEnv,
        *,
        max_turns: int | None = None,
        drop_thinking: bool = False,
        thinking_tag: str = "think",
    ) -> None:
        super().__init__(env)
        if max_turns is not None and (not isinstance(max_turns, int) or max_turns < 1):
            raise ArgumentError(f"max_turns must be a positive whole number or None, not {max_turns!r}")
        self.max_turns = max_turns
        self.drop_thinking = drop_thinking
        self.thinking_tag = thinking_tag
        self._task: Observation = ""
        self._turns: list[Turn] = []
        self._suffix: Observation = ""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the observation.

        Args:
            task: What the reset said.
            turns: The turns that are to be shown, oldest first.
            suffix: How things stand now; shown once, at the end.
        """
        raise NotImplementedError(f"{type(self).__name__} must define show(self, task, turns, suffix)")

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Begin a new list of turns."""
        observation, info = result
        self._task, self._suffix = told_apart(observation, info)
        self._turns = []
        return self._rendered(), info

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Add the turn and render the list."""
        observation, reward, terminated, truncated, info = result
        feedback, self._suffix = told_apart(observation, info)
        # A plain str: what the server reported about a response is kept by the rollout, not by the view.
        text = str.__str__(action)
        if self.drop_thinking:
            text = without_thinking(text, self.thinking_tag)
        self._turns.append(Turn(text, feedback))
        return self._rendered(), reward, terminated, truncated, info

    def _rendered(self) -> Observation:
        turns = self._turns if self.max_turns is None else self._turns[-self.max_turns :]
        return self.show(self._task, turns, self._suffix)

    def _get_state(self) -> dict[str, Any]:
        outputs = [self._task, self._suffix, *(turn.feedback for turn in self._turns)]
        if not all(isinstance(output, str) for output in outputs):
            raise StateNotSupported(f"{type(self).__name__} holds content parts, whose images are not plain data")
        return {
            "task": self._task,
            "turns": [[turn.action, turn.feedback] for turn in self._turns],
            "suffix": self._suffix,
        }

    def _set_state(self, state: dict[str, Any]) -> None:
        self._task, self._suffix = state["task"], state["suffix"]
        self._turns = [Turn(action, feedback) for action, feedback in state["turns"]]


class Latest(ObservationView):
    """Shows only the newest output, and how things stand now."""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the newest feedback and the suffix."""
        return observation_from(turns[-1].feedback if turns else task, suffix)


class Concat(ObservationView):
    """Shows all outputs so far, and how things stand now once, at the end."""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return the feedback of every turn and the suffix."""
        return observation_from(joined([task, *(turn.feedback for turn in turns)]), suffix)


class ConcatWithAction(ObservationView):
    """Shows all outputs and actions so far, and how things stand now once, at the end."""

    def show(self, task: Observation, turns: list[Turn], suffix: Observation) -> Observation:
        """Return action and feedback of every turn, and the suffix."""
        pieces = [task]
        for turn in turns:
            pieces += [turn.action, turn.feedback]
        return observation_from(joined(pieces), suffix)


def told_apart(observation: Observation, info: dict[str, Any]) -> tuple[Observation, Observation]:
    """Return what happened and how things stand now; without both keys in ``info`` all of it is feedback."""
    if "feedback" in info and "suffix" in info:
        return info["feedback"], info["suffix"]
    return observation, ""


def joined(pieces: Iterable[Observation]) -> Observation:
    """Join outputs and actions, each beginning on a line of its own; parts once there is one list of parts."""
    pieces = [piece for piece in pieces if piece]
    if all(isinstance(piece, str) for piece in pieces):
        texts = [str(piece) for piece in pieces]
        lines = [text if text.endswith("\n") else f"{text}\n" for text in texts[:-1]]
        return "".join([*lines, *texts[-1:]])
    parts: list[dict[str, Any]] = []
    for piece in pieces:
        if parts and parts[-1]["type"] == "text" and not parts[-1]["text"].endswith("\n"):
            parts[-1] = {**parts[-1], "text": parts[-1]["text"] + "\n"}
        parts.extend(as_parts(piece))
    return parts


def without_thinking(action: str, tag: str = "think") -> str:
    """Return a response without its thinking.

    Templates often open the block in the prompt, so that a response holds only the end of it: all up to the last
    closing tag goes. A block that is never closed goes to the end.
    """
    opening, closing = f"<{tag}>", f"</{tag}>"
    end = action.rfind(closing)
    first = action.find(opening)
    if end >= 0:
        before = action[:first] if 0 <= first < end else ""
        action = before + action[end + len(closing) :].lstrip()
    unclosed = action.find(opening)
    return action if unclosed < 0 else action[:unclosed]
