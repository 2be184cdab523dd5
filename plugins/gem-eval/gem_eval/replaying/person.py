"""A person goes on from a turn of a recorded episode, as in ``gem play``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gem_core as gem
from gem_core import Episode, PlanItem
from gem_core.cli import PlaySession
from gem_core.records import EpisodeStart
from gem_core.registry import registry
from gem_core.terminal import EndOfInput
from gem_eval.replaying.recorded import differences
from gem_eval.replaying.replay import Replay, recipe_of
from gem_eval.show.lines import episode_lines
from gem_eval.show.paging import write_lines
from gem_eval.show.text import rule

if TYPE_CHECKING:
    from gem_eval.records import Row, Run


def play_on(
    run: Run, row: Row, original: Episode, turns: int, kwargs: Mapping[str, Any] | None, episodes: int
) -> Replay:
    """Show an episode up to a turn, and let a person go on; return what was played to its end.

    Args:
        run: Where the episode is recorded.
        row: Its row.
        original: The episode.
        turns: How many turns are repeated.
        kwargs: Keyword arguments over the recorded ones.
        episodes: How many times it is gone on with.
    """
    env_id, arguments = recipe_of(original, kwargs)
    record = registry().env(env_id)
    if turns:
        first = replace(original, transitions=original.transitions[:turns], final_observation="")
        _, _, *lines = episode_lines(first, row.number)  # without the heading and the outcome
        write_lines(itertools.takewhile(lambda line: line != rule("end"), lines))
    run_seed = original.seed if original.run_seed is None else original.run_seed
    start = EpisodeStart(PlanItem(options=original.options), (0,), 0, original.seed or 0, run_seed or 0)
    played: list[Episode] = []
    with closing(gem.make(record, **arguments)) as env:
        session = PlaySession(
            env,
            seed=run_seed,
            repeatable=record.deterministic,
            exact=bool(arguments["wrappers"]),
            summary=record.summary,
            begun=(start, original.transitions[:turns]),
        )
        with suppress(EndOfInput):
            session.play(episodes)
        played = session.finished
    for number, episode in enumerate(played):
        episode.agent, episode.repeat = "human", number
    return Replay(run, row, original, turns, played, [differences(original, each, turns) for each in played])
