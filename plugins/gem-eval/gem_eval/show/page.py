"""One self-contained page of episodes: no network, no script but its own, and all text of others inert.

What is shown is data inside the page: JSON in which no character can end a script, put into the page as text by the
page's own script. The policy in its head allows that script and that style by their hashes, and images as data.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

from gem_core.errors import EpisodeFileError
from gem_core.records import ImageFolder, Record
from gem_eval.assets import read_assets, render
from gem_eval.episode_data import episode_data, image_names, png_of
from gem_eval.files import write_page
from gem_eval.show.text import escaped

MOST_IMAGE_BYTES = 64_000_000
"""Bytes of all images that go into the page."""


class PageWriter:
    """Gathers episodes, and writes the page.

    Args:
        title: Stands at the top, the name of the file as a rule.
        images: Where the episodes' images are.
        most_image_bytes: Images beyond so many bytes are left out.
    """

    def __init__(self, title: str, images: ImageFolder, most_image_bytes: int = MOST_IMAGE_BYTES) -> None:
        self.title = title
        self.notes: list[str] = []
        """Lines that stand above the episodes."""
        self._images = images
        self._image_bytes_left = most_image_bytes
        self._image_data: dict[str, str | None] = {}
        self._episodes: list[dict[str, Any]] = []

    def add(self, number: int, episode: Record) -> None:
        """Add an episode under its number."""
        data = episode_data(episode)
        for name in sorted(image_names(data) - self._image_data.keys()):
            self._image_data[name] = self._read_image(name)
        self._episodes.append({"number": number, **data})

    def html(self) -> str:
        """Return the page."""
        images = {name: data for name, data in self._image_data.items() if data is not None}
        notes = list(self.notes)
        if left_out := len(self._image_data) - len(images):
            notes.append(f"Images that cannot be read, or would be too much: {left_out}. Their names stand instead.")
        data = {"title": escaped(self.title), "notes": notes, "episodes": self._episodes, "images": images}
        return render(
            "page.html",
            style=read_assets("episode.css", "page.css"),
            script=read_assets("episode.js", "page.js"),
            data=inert_json(data),
        )

    def write(self, path: str | Path) -> None:
        """Write the page to a file, whole or not at all.

        Raises:
            ArgumentError: The file cannot be written.
        """
        write_page(Path(path), self.html())

    def _read_image(self, name: str) -> str | None:
        """Return an image as a data URL."""
        try:
            content = png_of(self._images, name)
        except EpisodeFileError:
            return None
        if len(content) > self._image_bytes_left:
            return None
        self._image_bytes_left -= len(content)
        return f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"


def inert_json(value: Any) -> str:
    """Return JSON that may stand in a script element: ASCII, and no character that HTML or JavaScript looks at."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
