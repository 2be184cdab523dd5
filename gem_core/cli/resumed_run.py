"""``ResumedRun``: the episodes in a file that ``gem run --resume`` keeps, and those that it runs again."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import click

from gem_core.cli.layout import counted
from gem_core.errors import ArgumentError
from gem_core.records.files import EpisodeLine, EpisodeWriter, episode_lines
from gem_core.records.joint import JointEpisode
from gem_core.records.plans import EpisodeQueue
from gem_core.records.summary import RunSummary
from gem_core.rollouts.resume import FinishedEpisodes


class ResumedRun:
    """The recorded episodes of a run that is resumed.

    Args:
        writer: Writes the file.
        agents: Names of the agents that act now.

    Raises:
        ArgumentError: It does not say of which run it is, or has games of other agents. Records of one
            agent do not name it.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, writer: EpisodeWriter, agents: Collection[str]) -> None:
        self.writer = writer
        self.path = path = writer.path
        self.done = FinishedEpisodes()
        self._again = 0
        seated: set[str] = set()
        for line in episode_lines(path):
            if line.episode is not None:
                self.done.add(line.episode)
            self._again += not _stays(line)
            if _stays(line) and isinstance(line.episode, JointEpisode):
                seated.update(line.episode.agents.values())
        if self.done and not self.done.run_seeds:
            raise ArgumentError(
                f"--resume: {path} does not say from which seed its run was started, since an earlier version wrote it"
            )

        if seated and seated != set(agents):
            found, given = (", ".join(sorted(names)) for names in (seated, agents))
            raise ArgumentError(
                f"--resume: {path} has games of {found}, and the agents given are {given}: name the same"
            )

    @property
    def seed(self) -> int | None:
        """Seed of the run; None for a file that is empty."""
        return self.done.run_seed(None)

    def begin(self, source: EpisodeQueue, summary: RunSummary) -> None:
        """Skip and count the finished episodes, and remove those that are run again from the file.

        Args:
            source: What the episodes of the whole run start from.
            summary: Where the episodes that stay are counted.

        Raises:
            ArgumentError: The file is of another run; it has not been changed.
            EpisodeFileError: It cannot be written.
        """
        self.done.leave_out_of(source)
        for line in episode_lines(self.path):
            if line.episode is not None and _stays(line):
                summary.add(line.episode)
        summary.begin_session()
        if self._again:
            self.writer.rewrite(line.text for line in episode_lines(self.path) if _stays(line))
            click.echo(f"gem: {counted(self._again, 'episode')} with an error or cut off: run again", err=True)


def file_to_resume(path: Path) -> EpisodeWriter:
    """Return the writer of the file of a run that is resumed.

    Raises:
        ArgumentError: There is no such file.
        EpisodeFileError: It cannot be written.
    """
    if not path.exists():
        raise ArgumentError(f"--resume: there is no file {path}; a run that begins takes --out")
    return EpisodeWriter(path, append=True)


def _stays(line: EpisodeLine) -> bool:
    return line.episode is not None and line.episode.error is None
