"""Find a text in what was observed, said and told in an episode; case does not count."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from gem_core import Episode

# Characters that JSON writes as they are.
_PLAIN_RUN = re.compile(r"[A-Za-z0-9 .,:;=()_-]+", re.ASCII)


def may_hold(line: bytes, text: str) -> bool:
    """Whether a recorded line may hold a text.

    To read an episode takes 20 times as long as to see that its line lacks the part of the text that JSON writes as it
    is.
    """
    run = max(_PLAIN_RUN.findall(text), key=len, default="").lower()
    return run.encode("ascii") in line.lower()


def found_text(episode: Episode, text: str) -> str | None:
    """Return the first piece of an episode that holds a text: an observation, a response, or what an info says."""
    wanted = text.casefold()
    return next((piece for piece in _texts(_shown(episode)) if wanted in piece.casefold()), None)


def _shown(episode: Episode) -> Any:
    turns = [(turn.observation, turn.action.text, turn.action.reported(), turn.info) for turn in episode.transitions]
    return episode.id, episode.observation, episode.info, turns, episode.final_observation


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list | tuple):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _texts(part)
