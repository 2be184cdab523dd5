"""``ResumedRun``: the episodes that ``gem run --resume`` keeps, the ones it runs again, and how they were run."""

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
from gem_core.records.redaction import BLOT
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
    """The recorded episodes of a run that is resumed, and with which agents, arguments and wrappers they were run.

    Args:
        writer: Writes the file.

    Raises:
        ArgumentError: It does not say from which seed its run was started.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, writer: EpisodeWriter) -> None:
        self.writer = writer
        self.path = path = writer.path
        self.done = FinishedEpisodes()
        settings: dict[bool, dict[str, Record]] = {True: {}, False: {}}
        for line in episode_lines(path):
            if line.episode is not None:
                self.done.add(line.episode)
                settings[_stays(line)].setdefault(_setting(line.episode), line.episode)
        self._kept = list(settings[True].values())
        """One episode of each setting: environment, agents, arguments and wrappers."""
        self._told = self._kept or list(settings[False].values())
        if self.done and not self.done.run_seeds:
            raise ArgumentError(
                f"--resume: {path} does not say from which seed its run was started, since an earlier version wrote it"
            )

    # What the file says where the command line does not.

    def agents(self) -> tuple[str, ...]:
        """Return the values of ``--agent``; none for an empty file.

        Raises:
            ArgumentError: The records do not name the agent, or several took part.
        """
        names = sorted({str(name) for episode in self._told for name in _agents_of(episode).values()})
        if len(names) > 1 or names == ["None"]:
            told = f"has games of {', '.join(names)}" if len(names) > 1 else "does not name its agent"
            raise ArgumentError(f"--resume: {self.path} {told}: name the same by --agent")
        return tuple(names)

    def arguments(self, envs: Envs) -> dict[str, Any]:
        """Return what ``--set`` gave to the environments, beside the keyword arguments that they have here.

        Raises:
            ArgumentError: A secret among it is not in the file.
        """
        own = {name for _, kwargs in envs for name in kwargs}
        given = {name: value for episode in self._told for name, value in episode.kwargs.items() if name not in own}
        self._refuse_blots(given, "--set")
        return given

    def wrappers(self) -> Wrappers:
        """Return the wrappers and tools.

        Raises:
            ArgumentError: A secret among their options is not in the file.
        """
        wrappers: Any = self._told[0].wrappers if self._told else []
        self._refuse_blots(wrappers, "--wrappers and --tools")
        return wrappers  # type: ignore[no-any-return]

    def _refuse_blots(self, given: Any, option: str) -> None:
        if BLOT in json.dumps(given, default=str):
            raise ArgumentError(f"--resume: {self.path} does not hold the secrets of {option}: give them again")

    def check(self, players: Players, envs: Envs, wrappers: Wrappers) -> None:
        """Raise an error if the kept episodes were run in another way than the new ones will be.

        Raises:
            ArgumentError: It says in what they differ.
        """
        agents = players.options.get("agents")
        by_seat = {seat: one.name for seat, one in agents.items()} if isinstance(agents, Mapping) else None
        for episode in self._kept:
            found = _agents_of(episode)
            if {*found.values()} not in ({*players.agents}, {None}) or (by_seat is not None and found != by_seat):
                self._refuse(
                    "--agent", found if by_seat else sorted(map(str, found.values())), by_seat or [*players.agents]
                )
            recorded = {"arguments": episode.kwargs, "wrappers": episode.wrappers}
            now = [_recorded(spec, kwargs, wrappers) for spec, kwargs in envs if spec.id == episode.id]
            if now and recorded not in now:
                self._refuse("--set, --wrappers, --tools or limits", recorded, now[0])

    def _refuse(self, option: str, found: Any, now: Any) -> None:
        before, after = (json.dumps(value, default=str)[:500] for value in (found, now))
        raise ArgumentError(
            f"--resume: {self.path} was run with another {option}: {before}, and now it is {after}; leave the option "
            "out to go on as before, or begin another file"
        )

    @property
    def seed(self) -> int | None:
        """Seed of the run; None for a file that is empty."""
        return self.done.run_seed(None)

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
