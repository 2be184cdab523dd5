"""``RecordedActions``: an agent that repeats a recorded episode; and how a replay differs from its record."""

from __future__ import annotations

import json
from collections.abc import Awaitable
from typing import Any

from gem_core import Episode, Observation
from gem_core.errors import EpisodeLimitError, RequestError
from gem_core.records import from_plain, to_plain
from gem_core.rollouts import Agent, AgentTraits, Context

END_OF_RECORD = "end of the record"
"""What cuts a replay off that has no more actions, where the episode is not over."""

_LONGEST = 60


class RecordedActions:
    """Repeats the responses of an episode, to the letter, and leaves later turns to another agent.

    It is sent what the other agent reads, who therefore finds the conversation as if it had acted from the beginning.

    Args:
        episode: The record.
        turns: How many turns are repeated.
        agent: Who acts then; None cuts the episode off.
        force: Go on where an observation or a reward is not as recorded; otherwise the episode ends in an error.
    """

    def __init__(self, episode: Episode, turns: int, agent: Agent | None, *, force: bool) -> None:
        self._episode, self._turns, self._agent, self._force = episode, turns, agent, force
        self.reads, self.system, self.native_tools = (
            AgentTraits("observation") if agent is None else AgentTraits.of(agent)
        )

    def __call__(self, observation: Observation, context: Context) -> str | Awaitable[str]:
        """Return the recorded response, or ask the other agent.

        Raises:
            RequestError: The replay differs from the record.
            EpisodeLimitError: There are no more actions.
        """
        turn = context.turn
        if turn <= self._turns and not self._force:
            last = context.transitions[-1] if context.transitions else None
            found = _step_difference(self._episode, turn, last) or _observation_difference(
                self._episode, turn, context.observation
            )
            if found:
                raise RequestError(f"the replay is not as recorded: {found}", cause="replay")
        if turn < self._turns:
            return self._episode.transitions[turn].action
        if self._agent is None:
            raise EpisodeLimitError("there are no more recorded actions", limit=END_OF_RECORD)
        return self._agent(observation, context)


def differences(recorded: Episode, replayed: Episode, turns: int) -> list[str]:
    """Return in words where the first turns of a replay differ from the record; empty where they agree.

    Args:
        recorded: The record.
        replayed: The replay.
        turns: How many turns were repeated.
    """
    found = []
    for turn in range(turns + 1):
        if turn > replayed.turns:
            found.append(f"turn {turn}: the replay was over before it")
            break
        last = replayed.transitions[turn - 1] if turn else None
        observation = replayed.final_observation if turn == replayed.turns else replayed.transitions[turn].observation
        both = _step_difference(recorded, turn, last), _observation_difference(recorded, turn, observation)
        found += [each for each in both if each]
    if turns == recorded.turns and replayed.turns == turns and recorded.error is None:
        was, is_now = recorded.success, replayed.success
        if was != is_now:
            found.append(f"the end: success was {was}, and is {is_now}")
    return found


def _step_difference(recorded: Episode, turn: int, replayed: Any) -> str | None:
    """Compare the result of the step before a turn, from 0."""
    if turn == 0 or replayed is None:
        return None
    last = recorded.transitions[turn - 1]
    compared = ["reward", "terminated", "truncated"]
    if turn == recorded.turns and not last.terminated and last.truncated:
        compared.remove("truncated")  # it may have been cut off between two turns, by a limit or an error
    for name in compared:
        was, is_now = to_plain(getattr(last, name)), to_plain(getattr(replayed, name))
        if was != is_now:
            return f"turn {turn}: {name} was {was}, and is {is_now}"
    return None


def _observation_difference(recorded: Episode, turn: int, observation: Observation) -> str | None:
    is_last = turn == recorded.turns
    before = recorded.final_observation if is_last else recorded.transitions[turn].observation
    # An image that was not read stands in a record as the plain form of one does.
    was, is_now = (_text(from_plain(to_plain(each))) for each in (before, observation))
    if was == is_now:
        return None
    place = next((number for number, pair in enumerate(zip(was, is_now, strict=False)) if pair[0] != pair[1]), -1)
    start = max(min(len(was), len(is_now)) if place < 0 else place - 10, 0)
    shown = [repr(text[start : start + _LONGEST]) for text in (was, is_now)]
    what = "the first observation" if turn == 0 else f"turn {turn}: what was answered"
    return f"{what} was {shown[0]}, and is {shown[1]} (from character {start})"


def _text(plain: Any) -> str:
    return plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)
