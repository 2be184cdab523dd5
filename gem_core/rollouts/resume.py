"""``FinishedEpisodes``: the episodes of a resumed run that need not be run again."""

from __future__ import annotations

from collections.abc import Iterable, Sized
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.records.episode import Episode
from gem_core.records.files import continue_file, read_records
from gem_core.records.joint import JointEpisode, Record
from gem_core.records.plain_json import to_plain
from gem_core.records.plans import EpisodeQueue, EpisodeStart


class FinishedEpisodes:
    """The finished episodes of a run: all that its file holds, except episodes that ended in an error."""

    def __init__(self) -> None:
        self.run_seeds: set[int] = set()
        """Seeds of the runs that the episodes belong to, those with an error included."""
        self._starts: dict[tuple[str, int], dict[str, Any]] = {}
        """``id``, ``seed``, ``options`` and ``agent`` of each, by its key and its repeat."""

    def __len__(self) -> int:
        return len(self._starts)

    def add(self, episode: Record) -> None:
        """Add an episode; of one with an error, only the seed of its run is kept."""
        if episode.run_seed is not None:
            self.run_seeds.add(episode.run_seed)
        if episode.error is None:
            agent = episode.agent if isinstance(episode, Episode) else None
            self.add_start(episode.key, episode.repeat, episode.id, episode.seed, episode.options, agent)

    def add_start(
        self, key: str, repeat: int, env_id: str, seed: int | None, options: Any = None, agent: str | None = None
    ) -> None:
        """Add a finished episode by what it started from, where its record need not be read.

        Args:
            key: Its place in the plan.
            repeat: Which of the item's episodes it is.
            env_id: Id of its environment.
            seed: Its seed.
            options: The options of ``reset``.
            agent: Name of the agent, if the item names one.
        """
        started = {"id": env_id, "seed": seed, "options": to_plain(options) or None, "agent": agent}
        self._starts[key, repeat] = started

    def run_seed(self, given: int | None) -> int | None:
        """Return the seed of the resumed run, or the one given if there is no episode.

        Raises:
            ArgumentError: The episodes belong to several runs, or to a run with another seed than the one given.
        """
        if not self.run_seeds:
            return given
        found = ", ".join(map(str, sorted(self.run_seeds)[:3]))
        if len(self.run_seeds) > 1:
            raise ArgumentError(f"the episodes to resume belong to {len(self.run_seeds)} runs, with the seeds {found}")
        if given not in (None, *self.run_seeds):
            raise ArgumentError(
                f"the episodes to resume belong to the run with seed {found}, and the seed given is {given}; leave "
                "the seed out, or name another file"
            )
        return next(iter(self.run_seeds))

    def leave_out_of(self, queue: EpisodeQueue) -> None:
        """Leave the finished episodes out of a run.

        With a plan of known length they are compared with it now, all of them; else each when its turn comes.

        Raises:
            ArgumentError: One of them started from something else than the plan has in its place, or has no place.
        """
        if isinstance(queue.plan, Sized):
            left = set(self._starts)
            for start in queue.starts():
                if left and self._includes(start):
                    left.remove((start.key, start.repeat))
                if not left:
                    break
            if left:
                raise _other_run(min(left)[0], "has no place in this plan")
        queue.leave_out(self._includes)

    def _includes(self, start: EpisodeStart) -> bool:
        """Tell whether an episode of the plan is finished; raise if the finished one has another start."""
        started = self._starts.get((start.key, start.repeat))
        if started is None:
            return False
        item = start.item
        planned = {"id": item.id, "seed": start.seed, "options": to_plain(item.options) or None, "agent": item.agent}
        for name, value in planned.items():
            if value != started[name] and (value is not None or name == "options"):
                raise _other_run(start.key, f"has {name}={started[name]!r}, and the plan {name}={value!r}")
        return True


def _other_run(key: str, difference: str) -> ArgumentError:
    return ArgumentError(
        f"the episode with the key {key!r} {difference}: it is of another run; resume with the plan and the "
        "seed of the first time"
    )


def finished_episodes(resume: str | Path | Iterable[Record] | FinishedEpisodes | None) -> FinishedEpisodes:
    """Return the finished episodes of a file, which may not be there yet, or of an iterable of episodes.

    New episodes are appended to that file.

    Raises:
        ArgumentError: Something in the iterable is no episode.
        EpisodeFileError: The file cannot be read.
    """
    if isinstance(resume, FinishedEpisodes):
        return resume
    if isinstance(resume, str | Path):
        continue_file(resume)
        resume = read_records(resume, images=False) if Path(resume).exists() else ()
    finished = FinishedEpisodes()
    for episode in resume or ():
        if not isinstance(episode, Episode | JointEpisode):
            raise ArgumentError(f"resume takes a file of episodes or the episodes themselves, not {episode!r:.100}")
        finished.add(episode)
    return finished
