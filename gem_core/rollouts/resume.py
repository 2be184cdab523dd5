"""What a run that is resumed has done already."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.records.episode import Episode
from gem_core.records.files import read_episodes
from gem_core.records.plain_json import to_plain
from gem_core.records.plans import EpisodeStart


@dataclass(slots=True)
class Start:
    """What an episode that is there started from, as far as a plan can be held against it.

    Args:
        id: Id of its environment.
        seed: Its seed.
        options: What ``reset`` got, as plain JSON.
    """

    id: str
    seed: int | None
    options: Any


@dataclass
class Done:
    """The episodes of a run that need not be run again.

    Args:
        starts: What each started from, by its place in the plan and its repeat.
        run_seeds: Seeds of the runs that they come from.
    """

    starts: dict[tuple[str, int], Start] = field(default_factory=dict)
    run_seeds: set[int] = field(default_factory=set)

    def add(self, episode: Episode) -> None:
        """Note an episode; one with an error says only of which run it is."""
        if episode.run_seed is not None:
            self.run_seeds.add(episode.run_seed)
        if episode.error is None:
            self.starts[episode.key, episode.repeat] = Start(episode.id, episode.seed, _plain(episode.options))

    def run_seed(self, given: int | None) -> int | None:
        """Return the seed of the run that goes on, the given one where nothing was done.

        Raises:
            ArgumentError: The episodes are of another run, or of several.
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

    def check(self, key: str, repeat: int, draw: EpisodeStart | None) -> None:
        """Hold an episode that is there against the plan.

        Args:
            key: Its place in the plan.
            repeat: Which of the item's episodes it is.
            draw: What the plan has there; None where there is no such place.

        Raises:
            ArgumentError: It started from something else.
        """
        difference = "has no place in this plan" if draw is None else _difference(self.starts[key, repeat], draw)
        if difference is not None:
            raise ArgumentError(
                f"the episode with the key {key!r} {difference}: it is of another run; resume with the plan and the "
                "seed of the first time"
            )


def _difference(start: Start, draw: EpisodeStart) -> str | None:
    wanted = draw.item.id
    if wanted is not None and start.id != wanted:
        return f"is of {start.id!r}, and the plan asks for {wanted!r}"
    if start.options != _plain(draw.item.options):
        return f"was started with options {start.options}, and the plan gives it {_plain(draw.item.options)}"
    return None if start.seed == draw.seed else f"was started from seed {start.seed}, and the plan gives it {draw.seed}"


def _plain(options: Mapping[str, Any] | None) -> Any:
    return to_plain(options) or None


def done_in(episodes: str | Path | Iterable[Episode] | Done | None) -> Done:
    """Return what was done, by a file of episodes or by the episodes themselves; those with an error do not count.

    A file that is not there yet holds none.

    Raises:
        ArgumentError: It is neither.
        EpisodeFileError: The file cannot be read.
    """
    if isinstance(episodes, Done):
        return episodes
    done = Done()
    if isinstance(episodes, str | Path):
        if not Path(episodes).exists():
            return done
        episodes = read_episodes(episodes, images=False)
    for episode in episodes or ():
        if not isinstance(episode, Episode):
            raise ArgumentError(f"resume takes a file of episodes or the episodes themselves, not {episode!r:.100}")
        done.add(episode)
    return done
