"""Replay an episode in its environment, made anew from the record; and branch off at a turn."""

from __future__ import annotations

import json
import os
from collections.abc import Awaitable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gem_core as gem
from gem_core import Episode, Observation, PlanItem, Transition
from gem_core.errors import AgentError, ArgumentError, EpisodeLimitError, GemError, RequestError, UnknownNameError
from gem_core.records import from_plain, to_plain
from gem_core.rollouts import Agent, AgentTraits, Context, as_agent, close_agent, load_agent, prepare_agent
from gem_eval.opening import opened, refuse_seats

if TYPE_CHECKING:
    from pathlib import Path

    from gem_eval.records import Row, Run

_BLOT = "***"
_HINT = (
    "A record leaves out arguments that are long, as the rows of a data set, and functions: give them by --set "
    "NAME=VALUE, or kwargs={…}"
)
END_OF_RECORD = "end of the record"
"""What cuts a replay off that has no more actions, where the episode is not over."""

_LONGEST = 60


@dataclass(frozen=True)
class Replay:
    """A replay of an episode, with or without branches.

    Args:
        run: Where the episode is recorded.
        row: Its row in the index.
        original: The episode.
        turns: How many turns were repeated.
        episodes: The replay; or the branches, where an agent went on.
        differences: For each of them, where its repeated turns differ from the record, in words.
    """

    run: Run
    row: Row
    original: Episode
    turns: int
    episodes: list[Episode]
    differences: list[list[str]]

    @property
    def agrees(self) -> bool:
        """Whether what was repeated went as recorded."""
        return not any(self.differences)


def replay(
    run: str | Path | Run,
    number: int,
    from_turn: int | None = None,
    agent: Agent | str | None = None,
    *,
    branches: int = 1,
    kwargs: Mapping[str, Any] | None = None,
    force: bool = False,
    options: Mapping[str, Any] | None = None,
) -> Replay:
    """Replay an episode: make its environment from the record, reset it with its seed, and repeat its actions.

    An agent goes on from a turn. It is sent the conversation up to there, with the recorded responses, as
    if they were its own.

    Args:
        run: A run, or its folder or file.
        number: Number of the episode, as ``gem show`` lists it.
        from_turn: The first turn that the agent plays, from 1; None repeats all.
        agent: Who goes on, or the name of one; None only repeats.
        branches: How many times it goes on from there.
        kwargs: Keyword arguments of the environment that the record lacks, or others than recorded.
        force: Go on where an observation or a reward is not as recorded. Without, such a branch ends in an error.
        options: Keyword arguments of an agent that is named.

    Raises:
        ArgumentError: The record does not say enough to make the environment; or there is no such episode or turn.
        EpisodeFileError: The episode cannot be read.
    """
    if agent is None and from_turn is not None:
        raise ArgumentError("from_turn is for an agent that goes on: give one")
    run = opened(run)
    row = run.row(number)
    refuse_seats([row])
    original = run.episode(row, images=True)
    over = bool(original.transitions) and original.transitions[-1].terminated
    if from_turn is not None and not 1 <= from_turn <= original.turns + (not over):
        raise ArgumentError(f"there is no turn {from_turn} to go on from: the episode has {original.turns}, from 1")
    own = load_agent(agent, **(options or {})) if isinstance(agent, str) else None if agent is None else as_agent(agent)
    with ExitStack() as at_end:
        if own is not None:
            if isinstance(agent, str):
                at_end.callback(close_agent, own)
            prepare_agent(own)
        episodes = repeated(original, from_turn, own, branches=branches, kwargs=kwargs, force=force)
    turns = original.turns if from_turn is None else from_turn - 1
    for episode in episodes:
        episode.agent = agent if isinstance(agent, str) else None
    return Replay(run, row, original, turns, episodes, [differences(original, each, turns) for each in episodes])


def repeated(
    original: Episode,
    from_turn: int | None = None,
    agent: Agent | None = None,
    *,
    branches: int = 1,
    kwargs: Mapping[str, Any] | None = None,
    force: bool = False,
) -> list[Episode]:
    """Return the episodes of a replay; see ``replay`` for the arguments, and for what it raises."""
    turns = original.turns if from_turn is None else from_turn - 1
    recipe = recipe_of(original, kwargs)
    item = PlanItem(seed=original.seed, options=original.options, repeat=branches)
    acting = RecordedActions(original, turns, agent, force=force or agent is None)
    at_once = 1 if getattr(agent, "interactive", False) else min(branches, getattr(agent, "max_concurrency", branches))
    try:
        played = list(gem.rollout([recipe], acting, plan=[item], seed=original.run_seed, num_envs=at_once))
    except AgentError:
        raise
    except GemError as error:
        hint = "" if isinstance(error, UnknownNameError) else f". {_HINT}"
        raise ArgumentError(f"{original.id} cannot be made from its record: {error}{hint}") from error
    return sorted(played, key=lambda each: each.repeat)


def recipe_of(episode: Episode, kwargs: Mapping[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
    """Return the id and the keyword arguments, wrappers among them, that an episode's environment was made with.

    Raises:
        ArgumentError: The record lacks a secret, or the seed.
    """
    arguments = {**episode.kwargs, **(kwargs or {})}
    if episode.seed is None:
        raise ArgumentError("the record does not say the seed of the episode, so that it cannot be repeated")
    if _BLOT in json.dumps(to_plain([arguments, episode.wrappers])):
        raise ArgumentError(
            f"the record of {episode.id} blots out a secret: give it by --set NAME=VALUE, and to wrappers as the name "
            "of an environment variable, ${TOKEN}"
        )
    for name, _ in episode.wrappers:
        if str(name).startswith("<"):
            raise ArgumentError(
                f"{episode.id} was played with {name}, an object that a record cannot name: register the tool or "
                "wrapper, or name it as 'module:Class'"
            )
    return episode.id, {**arguments, "wrappers": [(name, options) for name, options in episode.wrappers]}


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
            found = _differences_at(self._episode, turn, last, context.observation)
            if found:
                raise RequestError(f"the replay is not as recorded: {found[0]}", cause="replay")
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
        found += _differences_at(recorded, turn, last, observation)
    if turns == recorded.turns and replayed.turns == turns and recorded.error is None:
        was, is_now = recorded.success, replayed.success
        if was != is_now:
            found.append(f"the end: success was {was}, and is {is_now}")
    return found


def _differences_at(recorded: Episode, turn: int, last: Transition | None, observation: Observation) -> list[str]:
    """Compare a turn, from 0, with the record: the result of the step before it, and the observation."""
    found = []
    if turn and last is not None:
        before = recorded.transitions[turn - 1]
        compared = ["reward", "terminated", "truncated"]
        if turn == recorded.turns and not before.terminated and before.truncated:
            compared.remove("truncated")  # it may have been cut off between two turns, by a limit or an error
        pairs = {name: (to_plain(getattr(before, name)), to_plain(getattr(last, name))) for name in compared}
        differing = [f"turn {turn}: {name} was {was}, and is {now}" for name, (was, now) in pairs.items() if was != now]
        found += differing[:1]
    seen = recorded.final_observation if turn == recorded.turns else recorded.transitions[turn].observation
    # An image that was not read stands in a record as the plain form of one does.
    texts = [
        plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False)
        for plain in (from_plain(to_plain(each)) for each in (seen, observation))
    ]
    if texts[0] != texts[1]:
        start = max(len(os.path.commonprefix(texts)) - 10, 0)  # noqa: RUF071 - of texts, not of paths
        was, now = (repr(text[start : start + _LONGEST]) for text in texts)
        what = f"turn {turn}: what was answered" if turn else "the first observation"
        found.append(f"{what} was {was}, and is {now} (from character {start})")
    return found
