"""``ResumedRun``: the episodes that ``gem run --resume`` keeps, and the ones it runs again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any, cast

import click

from gem_core.api import make
from gem_core.cli.layout import counted
from gem_core.errors import ArgumentError
from gem_core.records.episode import Episode
from gem_core.records.files import EpisodeLine, EpisodeWriter, episode_lines
from gem_core.records.joint import Record
from gem_core.records.plans import EpisodeQueue
from gem_core.records.summary import RunSummary
from gem_core.registry.specs import EnvSpec
from gem_core.rollouts.resume import FinishedEpisodes

if TYPE_CHECKING:
    from gem_core.cli.players import Players
    from gem_core.making.environment import MadeSpec
    from gem_core.making.layers import Wrappers

Envs = Sequence[tuple[EnvSpec, Mapping[str, Any]]]
"""Environments, each with keyword arguments."""


class ResumedRun:
    """The recorded episodes of a run that is resumed.

    Args:
        writer: Writes the file, which is locked from now on.

    Raises:
        ArgumentError: It does not say from which seed its run was started.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, writer: EpisodeWriter) -> None:
        self.writer, self.path = writer, writer.path
        self.done = FinishedEpisodes()
        self._kept: dict[str, Record] = {}
        """One episode of each setting: environment, agents, arguments and wrappers."""
        for line in episode_lines(self.path):
            if line.episode is not None:
                self.done.add(line.episode)
                if _stays(line):
                    self._kept.setdefault(_setting(line.episode), line.episode)
        if self.done and not self.done.run_seeds:
            raise ArgumentError(
                f"--resume: {self.path} does not say from which seed its run was started, since an earlier version "
                "wrote it"
            )

    def check(self, players: Players, envs: Envs, wrappers: Wrappers) -> None:
        """Raise an error if the kept episodes were run in another way than the new ones will be.

        Raises:
            ArgumentError: It says in what they differ.
        """
        agents = players.options.get("agents")
        by_seat = {seat: one.name for seat, one in agents.items()} if isinstance(agents, Mapping) else None
        for episode in self._kept.values():
            found = _agents_of(episode)
            if by_seat is not None and found != by_seat:
                self._refuse("--agent", found, by_seat)
            if {*found.values()} not in ({*players.agents}, {None}):
                self._refuse("--agent", sorted(map(str, found.values())), [*players.agents])
            recorded = {"arguments": episode.kwargs, "wrappers": episode.wrappers}
            now = [_recorded(spec, kwargs, wrappers) for spec, kwargs in envs if spec.id == episode.id]
            if now and recorded not in now:
                self._refuse("--set, --wrappers, --tools or limits", recorded, now[0])

    def _refuse(self, option: str, found: Any, now: Any) -> None:
        before, after = (json.dumps(value, default=str)[:500] for value in (found, now))
        raise ArgumentError(
            f"--resume: {self.path} was run with another {option}: {before}, and now it is {after}; give the same "
            "options again, or begin another file"
        )

    def begin(self, source: EpisodeQueue, summary: RunSummary) -> None:
        """Skip and count the finished episodes, and remove from the file the ones that are run again.

        Args:
            source: What the episodes of the whole run start from.
            summary: Where the episodes that stay are counted.

        Raises:
            ArgumentError: The file is of another run; it has not been changed.
            EpisodeFileError: It cannot be written.
        """
        self.done.leave_out_of(source)
        again = 0
        for line in episode_lines(self.path):
            if line.episode is not None and _stays(line):
                summary.add(line.episode)
            else:
                again += 1
        summary.begin_session()
        if again:
            self.writer.rewrite(line.text for line in episode_lines(self.path) if _stays(line))
            click.echo(f"gem: {counted(again, 'episode')} with an error or cut off: run again", err=True)


def _setting(episode: Record) -> str:
    """Return a text that is the same for episodes that were run in the same way."""
    return json.dumps([episode.id, _agents_of(episode), episode.kwargs, episode.wrappers], default=str)


def _agents_of(episode: Record) -> dict[str, str | None]:
    """Return the name of the agent at each seat; of one agent, under ``""``."""
    return {"": episode.agent} if isinstance(episode, Episode) else {**episode.agents}


def _recorded(spec: EnvSpec, kwargs: Mapping[str, Any], wrappers: Wrappers) -> dict[str, Any]:
    """Return the arguments and wrappers of an environment as the records of its episodes hold them."""
    with closing(make(spec, wrappers=wrappers, **kwargs)) as env:
        fields = Episode(seed=None, observation="", info={}, **cast("MadeSpec", env.spec).recorded()).to_dict()
    return {"arguments": fields["kwargs"], "wrappers": fields["wrappers"]}


def _stays(line: EpisodeLine) -> bool:
    return line.episode is not None and line.episode.error is None
