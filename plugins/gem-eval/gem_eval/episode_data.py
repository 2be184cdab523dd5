"""An episode as data for a page: what ``gem show --html`` and ``gem view`` send to the same script."""

from __future__ import annotations

import io
from typing import Any

from gem_core import Episode
from gem_core.errors import EpisodeFileError
from gem_core.records import ImageFolder, Record
from gem_eval.show.text import escaped
from gem_eval.turns import (
    Block,
    Part,
    TurnView,
    episodes_of,
    error_text,
    figures_of,
    outcome_of,
    parts_of,
    start_of,
    turn_views,
)

MOST_TEXT = 100_000
"""Characters of one text that a page gets; a browser is slow with more."""


def episode_data(episode: Record) -> dict[str, Any]:
    """Return what is shown of an episode as plain JSON: texts escaped and cut where they are long, numbers finite.

    Args:
        episode: The episode, its images as names of files.
    """
    seats = episodes_of(episode)
    data: dict[str, Any] = _plain(
        {
            "id": episode.id,
            "outcome": outcome_of(*(each.success for each in seats), failed=episode.error is not None),
            "return": f"{sum(each.episode_return for each in seats):.4g}",
            "returns": ", ".join(f"{each.seat}={each.agent} {each.episode_return:.4g}" for each in seats if each.seat),
            "count": episode.turns,
            "error": error_text(episode.error),
            "start": {
                **{each.seat: f"{each.agent}, {_outcome(each)}" for each in seats if each.seat},
                **start_of(episode),
            },
            "observation": _observations([each for each in seats if not each.transitions], "observation"),
            "turns": list(turn_views(episode)),
            "final": _observations(seats, "final_observation"),
        }
    )
    return data


def image_names(data: Any) -> set[str]:
    """Return the names of all images in an episode's data."""
    if isinstance(data, list):
        return {name for part in data for name in image_names(part)}
    if not isinstance(data, dict):
        return set()
    if data.get("kind") == "image" and isinstance(data.get("repeated"), bool):
        return {data["text"]}
    return {name for part in data.values() for name in image_names(part)}


def png_of(images: ImageFolder, name: str) -> bytes:
    """Return an image as a PNG that is written anew, so that nothing else of its file is shown to anybody.

    Raises:
        EpisodeFileError: It cannot be read, or the name is none of an image's.
    """
    image = images.read(name)
    if image.mode not in ("1", "L", "LA", "P", "RGB", "RGBA", "I;16"):
        image = image.convert("RGBA" if "A" in image.mode else "RGB")
    buffer = io.BytesIO()
    try:
        image.save(buffer, format="PNG")
    except (OSError, ValueError) as error:
        raise EpisodeFileError(f"image {name} cannot be shown: {error}") from error
    return buffer.getvalue()


def _observations(seats: list[Episode], name: str) -> list[Part]:
    """Return an observation of some seats, each under the name of its seat."""
    return [
        part
        for each in seats
        for part in [*([] if each.seat is None else [Part("role", each.seat)]), *parts_of(getattr(each, name))]
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        rest = len(value) - MOST_TEXT
        return escaped(value) if rest <= 0 else f"{escaped(value[:MOST_TEXT])}\n… {rest:,} more characters"
    if isinstance(value, float):
        return value if abs(value) < 1e300 else 0.0
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, TurnView):
        return {**_plain(vars(value)), "rewardText": f"{value.reward:g}"}
    if isinstance(value, Part | Block):
        value = vars(value)
    return (
        {escaped(str(name)[:1000]): _plain(part) for name, part in value.items()} if isinstance(value, dict) else value
    )


def _outcome(episode: Episode) -> str:
    return f"{outcome_of(episode.success, failed=episode.error is not None)}, {figures_of(episode)}"
