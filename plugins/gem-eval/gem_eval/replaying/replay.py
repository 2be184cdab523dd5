"""Replay an episode in its environment, made anew from the record; and branch off at a turn."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gem_core as gem
from gem_core import Episode, PlanItem
from gem_core.errors import ArgumentError, GemError, UnknownNameError
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
    max_requests: int | None = None,
) -> Replay:
    """Replay an episode: make its environment from the record, reset it with its seed, and repeat its actions.

    With an agent, that goes on from a turn. It is sent the conversation up to there, with the recorded responses, as
    if they were its own.

    Args:
        run: A run, or its folder or file.
        number: Number of the episode, as ``gem show`` lists it.
        from_turn: The first turn that the agent plays, from 1; None repeats all.
        agent: Who goes on, or the name of one; None only repeats.
        branches: How many times it goes on from there.
        kwargs: Keyword arguments of the environment that the record lacks, or others than recorded.
        force: Go on where an observation or a reward is not as recorded. Without, such a branch ends in an error.
        max_requests: How many branches are played at once; None for all.

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
    turns = repeated_turns(original, from_turn)
    if agent is None:
        (replayed,) = repeat_episode(original, RecordedActions(original, turns, None, force=True), kwargs)
        return Replay(run, row, original, turns, [replayed], [differences(original, replayed, turns)])
    loaded = load_agent(agent) if isinstance(agent, str) else as_agent(agent)
    try:
        prepare_agent(loaded)
        acting = RecordedActions(original, turns, loaded, force=force)
        episodes = repeat_episode(original, acting, kwargs, branches, max_requests or branches)
    finally:
        if isinstance(agent, str):
            close_agent(loaded)
    for episode in episodes:
        episode.agent = agent if isinstance(agent, str) else None
    return Replay(run, row, original, turns, episodes, [differences(original, each, turns) for each in episodes])


def repeated_turns(episode: Episode, from_turn: int | None) -> int:
    """Return how many turns are repeated.

    Raises:
        ArgumentError: The episode has no such turn.
    """
    if from_turn is None:
        return episode.turns
    over = bool(episode.transitions) and episode.transitions[-1].terminated
    last = episode.turns if over else episode.turns + 1
    if not 1 <= from_turn <= last:
        raise ArgumentError(f"there is no turn {from_turn} to go on from: the episode has {episode.turns}, from 1")
    return from_turn - 1


def repeat_episode(
    episode: Episode, agent: Any, kwargs: Mapping[str, Any] | None = None, times: int = 1, num_envs: int = 1
) -> list[Episode]:
    """Let an agent act from the start of a recorded episode; return the new episodes, in order.

    Args:
        episode: The record.
        agent: Who acts.
        kwargs: Keyword arguments over the recorded ones.
        times: How often.
        num_envs: How many at once.

    Raises:
        ArgumentError: The environment cannot be made from the record.
    """
    entry = recipe_of(episode, kwargs)
    item = PlanItem(seed=episode.seed, options=episode.options, repeat=times)
    try:
        found = list(gem.rollout([entry], agent, plan=[item], seed=episode.run_seed, num_envs=min(times, num_envs)))
    except GemError as error:
        raise _not_made(episode, error) from error
    return sorted(found, key=lambda each: each.repeat)


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
