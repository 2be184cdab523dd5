"""Replay an episode in its environment, made anew from the record; and branch off at a turn."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gem_core as gem
from gem_core import Episode, PlanItem
from gem_core.errors import AgentError, ArgumentError, GemError, UnknownNameError
from gem_core.records import to_plain
from gem_core.rollouts import Agent, as_agent, close_agent, load_agent, prepare_agent
from gem_eval.opening import opened, refuse_seats
from gem_eval.replaying.recorded import RecordedActions, differences

if TYPE_CHECKING:
    from gem_eval.records import Row, Run

_BLOT = "***"
_HINT = (
    "A record leaves out arguments that are long, as the rows of a data set, and functions: give them by --set "
    "NAME=VALUE, or kwargs={…}"
)


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
    turns = original.turns if from_turn is None else from_turn - 1
    own = load_agent(agent, **(options or {})) if isinstance(agent, str) else None if agent is None else as_agent(agent)
    recipe = recipe_of(original, kwargs)
    item = PlanItem(seed=original.seed, options=original.options, repeat=branches)
    acting = RecordedActions(original, turns, own, force=force or own is None)
    at_once = 1 if getattr(own, "interactive", False) else min(branches, getattr(own, "max_concurrency", branches))
    with ExitStack() as at_end:
        if own is not None:
            if isinstance(agent, str):
                at_end.callback(close_agent, own)
            prepare_agent(own)
        try:
            played = list(gem.rollout([recipe], acting, plan=[item], seed=original.run_seed, num_envs=at_once))
        except AgentError:
            raise
        except GemError as error:
            raise _not_made(original, error) from error
    episodes = sorted(played, key=lambda each: each.repeat)
    for episode in episodes:
        episode.agent = agent if isinstance(agent, str) else None
    return Replay(run, row, original, turns, episodes, [differences(original, each, turns) for each in episodes])


def repeat_all(
    episodes: Sequence[Episode], kwargs: Mapping[str, Any] | None = None, num_envs: int = 8
) -> Iterator[tuple[int, Episode | GemError]]:
    """Replay whole episodes; yield each replay with the place of its episode, in any order, or why there is none.

    Differences from the record do not stop a replay. Episodes whose environments are made alike share them.

    Args:
        episodes: The records.
        kwargs: Keyword arguments over the recorded ones.
        num_envs: How many environments run at once.
    """
    alike: dict[str, tuple[tuple[str, dict[str, Any]], list[int]]] = {}
    for place, episode in enumerate(episodes):
        try:
            recipe = recipe_of(episode, kwargs)
        except ArgumentError as error:
            yield place, error
        else:
            alike.setdefault(json.dumps(to_plain(recipe), sort_keys=True), (recipe, []))[1].append(place)
    for recipe, places in alike.values():
        agents = {
            str(place): RecordedActions(episodes[place], episodes[place].turns, None, force=True) for place in places
        }
        plan = [
            PlanItem(seed=episodes[place].seed, options=episodes[place].options, agent=str(place)) for place in places
        ]
        try:
            # The seed of the run does not matter: each item has its own.
            for replayed in gem.rollout([recipe], agents, plan=plan, seed=0, num_envs=min(num_envs, len(plan))):
                places.remove(int(replayed.agent or 0))
                yield int(replayed.agent or 0), replayed
        except GemError as error:
            for place in places:
                yield place, _not_made(episodes[place], error)


def recipe_of(episode: Episode, kwargs: Mapping[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
    """Return the id and the keyword arguments, wrappers among them, that an episode's environment was made with.

    Raises:
        ArgumentError: The record lacks a secret, or the seed.
    """
    arguments = {**episode.kwargs, **(kwargs or {})}
    if episode.seed is None:
        raise ArgumentError("the record does not say the seed of the episode, so that it cannot be repeated")
    for name, value in arguments.items():
        if _holds_blot(value):
            raise ArgumentError(
                f"the record of {episode.id} blots out a secret in {name}: give it by --set {name}=VALUE"
            )
    for name, options in episode.wrappers:
        if _holds_blot(options):
            raise ArgumentError(
                f"the record of {episode.id} blots out a secret of the wrapper {name}, so it cannot be made again: "
                "give wrappers the name of an environment variable in place of a secret, as ${TOKEN}"
            )
        if str(name).startswith("<"):
            raise ArgumentError(
                f"{episode.id} was played with {name}, an object that a record cannot name: register the tool or "
                "wrapper, or name it as 'module:Class'"
            )
    return episode.id, {**arguments, "wrappers": [(name, options) for name, options in episode.wrappers]}


def _not_made(episode: Episode, error: GemError) -> ArgumentError:
    hint = "" if isinstance(error, UnknownNameError) else f". {_HINT}"
    return ArgumentError(f"{episode.id} cannot be made from its record: {error}{hint}")


def _holds_blot(value: Any) -> bool:
    if isinstance(value, str):
        return _BLOT in value
    parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return any(map(_holds_blot, parts))
