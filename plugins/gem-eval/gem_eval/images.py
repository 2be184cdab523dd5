"""Images of episodes as data URLs."""

from __future__ import annotations

import base64
import io

from gem_core.records import ImageFolder


def data_url(images: ImageFolder, name: object) -> str:
    """Return an image as a data URL of a PNG written anew, so that nothing else of its file gets into a page.

    Raises:
        EpisodeFileError: The image cannot be read.
    """
    image = images.read(name)
    if image.mode not in ("1", "L", "LA", "P", "RGB", "RGBA", "I;16"):
        image = image.convert("RGBA" if "A" in image.mode else "RGB")
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
