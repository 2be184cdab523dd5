"""One self-contained page of episodes: no network, nothing executed but its own script, and all text of others inert.

What is shown is data inside the page: JSON in which no character can end a script, put into the page as text by the
page's own script. The policy in its head allows that script and that style by their hashes, and images as data.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

from gem_core.cli.viewing.terminal import escaped
from gem_core.cli.viewing.turns import Part, TurnView, error_text, outcome_of, parts_of, start_of, turn_views
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records.episode import Episode
from gem_core.records.plain_json import ImageFolder

MOST_TEXT = 100_000
"""Characters of one text that go into the page; a browser is slow with more."""

MOST_IMAGE_BYTES = 64_000_000
"""Bytes of all images that go into the page."""

_PNG = b"\x89PNG\r\n\x1a\n"


class PageWriter:
    """Gathers episodes, and writes the page.

    Args:
        title: Stands at the top, the name of the file as a rule.
        images: Where the episodes' images are.
        most_image_bytes: Images beyond so many bytes are left out.
    """

    def __init__(self, title: str, images: ImageFolder, most_image_bytes: int = MOST_IMAGE_BYTES) -> None:
        self.title = title
        self._images = images
        self._most_image_bytes = most_image_bytes
        self._episodes: list[dict[str, Any]] = []
        self._image_data: dict[str, str] = {}
        self._image_bytes = 0
        self.notes: list[str] = []
        self._left_out_images: set[str] = set()

    def add(self, number: int, episode: Episode) -> None:
        """Add an episode under its number."""
        self._episodes.append(
            {
                "number": number,
                "id": self._text(episode.id),
                "outcome": outcome_of(episode.success, None if episode.error is None else ""),
                "return": f"{episode.episode_return:.4g}",
                "error": self._text(error_text(episode.error)),
                "start": {name: self._text(value) for name, value in start_of(episode).items()},
                "observation": [] if episode.transitions else self._parts(parts_of(episode.observation)),
                "turns": [self._turn(turn) for turn in turn_views(episode)],
                "final": self._parts(parts_of(episode.final_observation)),
            }
        )

    def html(self) -> str:
        """Return the page."""
        notes = list(self.notes)
        if self._left_out_images:
            count = len(self._left_out_images)
            notes.append(f"Images that cannot be read, or would be too much: {count}. Their names stand instead.")
        data = {"title": escaped(self.title), "notes": notes, "episodes": self._episodes, "images": self._image_data}
        assets = resources.files("gem_core.cli.viewing") / "assets"
        style, script, page = (
            (assets / name).read_text(encoding="utf-8").replace("\r\n", "\n")
            for name in ("page.css", "page.js", "page.html")
        )
        policy = (
            f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src data:; "
            "base-uri 'none'; form-action 'none'"
        )
        # The data come last: what they hold is not looked at again.
        for mark, text in (("POLICY", policy), ("STYLE", style), ("SCRIPT", script)):
            page = page.replace(f"{{{{{mark}}}}}", text)
        before, _, behind = page.partition("{{DATA}}")
        return before + inert_json(data) + behind

    def write(self, path: str | Path) -> None:
        """Write the page to a file, whole or not at all.

        Raises:
            ArgumentError: The file cannot be written.
        """
        path = Path(path)
        page = self.html()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
            partial.write_text(page, encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise ArgumentError(f"cannot write {path}: {error.strerror or error}") from error

    def _turn(self, turn: TurnView) -> dict[str, Any]:
        return {
            "number": turn.number,
            "observation": self._parts(turn.observation),
            "response": self._text(turn.response),
            "reasoning": self._text(turn.reasoning),
            "calls": [self._text(call) for call in turn.calls],
            "reported": self._text(turn.reported),
            "reward": _finite(turn.reward),
            "rewardText": f"{turn.reward:g}",
            "flags": turn.flags,
            "feedback": self._parts(turn.feedback),
            "error": self._text(turn.error),
            "rest": {self._text(name): self._text(value) for name, value in turn.rest.items()},
        }

    def _parts(self, parts: Iterable[Part]) -> list[dict[str, Any]]:
        shown = []
        for part in parts:
            record: dict[str, Any] = {"kind": part.kind, "text": self._text(part.text)}
            if part.repeated:
                record["repeated"] = True
            if part.kind == "image":
                self._take_image(part.text)
            shown.append(record)
        return shown

    def _text(self, text: str) -> str:
        left_out = len(text) - MOST_TEXT
        return escaped(text) if left_out <= 0 else f"{escaped(text[:MOST_TEXT])}\n… {left_out:,} more characters"

    def _take_image(self, name: str) -> None:
        if name in self._image_data or name in self._left_out_images:
            return
        try:
            content = _png(self._images, name)
        except EpisodeFileError:
            content = b""
        if not content or self._image_bytes + len(content) > self._most_image_bytes:
            self._left_out_images.add(name)
            return
        self._image_bytes += len(content)
        self._image_data[name] = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"


def inert_json(value: Any) -> str:
    """Return JSON that may stand in a script element: ASCII, and no character that HTML or JavaScript looks at."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _png(images: ImageFolder, name: str) -> bytes:
    """Return an image as PNG, written anew: what else a file holds does not get into the page."""
    image = images.read(name)
    if image.mode not in ("1", "L", "LA", "P", "RGB", "RGBA", "I;16"):
        image = image.convert("RGBA" if "A" in image.mode else "RGB")
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


def _finite(value: float) -> float:
    return value if abs(value) < 1e300 else 0.0
