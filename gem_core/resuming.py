"""What a run that is resumed has done already."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from gem_core.episodes import Episode, read_episodes
from gem_core.errors import ArgumentError


@dataclass
class Done:
    """The episodes of a run that need not be run again.

    Args:
        seeds: Seed of each, by its place in the plan and its repeat.
        run_seeds: Seeds of the runs that they come from.
    """

    seeds: dict[tuple[str, int], int | None] = field(default_factory=dict)
    run_seeds: set[int] = field(default_factory=set)

    def run_seed(self, given: int | None) -> int | None:
        """Return the seed of the run that goes on, the given one where nothing was done.

        Raises:
            ArgumentError: The episodes are of another run, or of several.
        """
        if not self.run_seeds:
            return given
        if len(self.run_seeds) > 1 or given not in (None, *self.run_seeds):
            found = ", ".join(map(str, sorted(self.run_seeds)[:3]))
            asked = "" if given is None else f", and the seed given is {given}"
            raise ArgumentError(f"the episodes to resume belong to the run with seed {found}{asked}")
        return next(iter(self.run_seeds))


def done_in(episodes: str | Path | Iterable[Episode] | None) -> Done:
    """Return what was done, by a file of episodes or by the episodes themselves; those with an error do not count.

    A file that is not there yet holds none.

    Raises:
        EpisodeFileError: The file cannot be read.
    """
    done = Done()
    if isinstance(episodes, str | Path):
        if not Path(episodes).exists():
            return done
        episodes = read_episodes(episodes)
    for episode in episodes or ():
        if episode.run_seed is not None:
            done.run_seeds.add(episode.run_seed)
        if episode.error is None:
            done.seeds[episode.key, episode.repeat] = episode.seed
    return done
