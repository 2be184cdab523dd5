"""Convert any value to plain JSON, with images as side files, so that writing a record never fails."""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from gem_core.errors import EpisodeFileError

_IMAGE_KEY, _TEXT_KEY, _PLAIN_KEY = "__image__", "__text__", "__plain__"
_MARKS = {_IMAGE_KEY, _TEXT_KEY, _PLAIN_KEY}
# JSON readers take two surrogates side by side for one character, so such text is written in pieces.
_BETWEEN_SURROGATES = re.compile("(?<=[\ud800-\udbff])(?=[\udc00-\udfff])")
_IMAGE_NAME = re.compile(r"[0-9a-f]{64}\.(png|tiff)", re.ASCII)
_PNG_MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "I;16")
_MAX_DEPTH = 100
_MAX_BITS = 14_000


class ImageFolder:
    """A folder of images, each in a file named by the hash of what it shows.

    Args:
        path: The folder; it is made when the first image is written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def beside(cls, file: Path) -> Self:
        """Return the folder that belongs to a file of episodes: ``run.images`` for ``run.jsonl``."""
        return cls(file.with_suffix(".images"))

    def write(self, image: Any) -> str:
        """Write a PIL image without loss, unless its file exists, and return the file name."""
        name = image_name(image)
        target = self.path / name
        if not target.exists():
            buffer = io.BytesIO()
            image.save(buffer, format="PNG" if name.endswith(".png") else "TIFF")
            self.path.mkdir(parents=True, exist_ok=True)
            partial = target.with_suffix(".partial")
            partial.write_bytes(buffer.getvalue())
            partial.replace(target)
        return name

    def read(self, name: object) -> Any:
        """Return the PIL image of that name.

        Raises:
            EpisodeFileError: The name is none of ours, the file is missing or damaged, or Pillow is not installed.
        """
        if not isinstance(name, str) or not _IMAGE_NAME.fullmatch(name):
            raise EpisodeFileError(f"{name!r:.100} is not the name of an image file")
        try:
            from PIL import Image
        except ModuleNotFoundError as error:
            raise EpisodeFileError("reading images needs Pillow: pip install 'gem-core[images]'") from error
        try:
            with Image.open(self.path / name, formats=("PNG", "TIFF")) as image:
                image.load()
                return image.copy()
        except Exception as error:  # damaged files make Pillow fail in many ways
            raise EpisodeFileError(f"image {name} cannot be read: {error}") from error


def image_name(image: Any) -> str:
    """Return the file name of a PIL image: the SHA-256 of mode, size, palette and pixels."""
    digest = hashlib.sha256(f"{image.mode} {image.size}".encode())
    palette = image.getpalette() if image.mode == "P" else None
    digest.update(repr(palette).encode())
    digest.update(image.tobytes())
    return f"{digest.hexdigest()}.{'png' if image.mode in _PNG_MODES else 'tiff'}"


def to_plain(value: Any, images: ImageFolder | None = None, above: tuple[int, ...] = ()) -> Any:
    """Return a value as plain JSON.

    Tuples and arrays become lists, numbers that are not finite their names, whole numbers of over 4,200 digits their
    hexadecimal form, and what JSON does not know its ``repr``.

    Args:
        value: Anything.
        images: The folder for images; None keeps only their hash.
        above: Identities of the containers that it stands in, outermost first.
    """
    # Tuples of types are tried faster than unions, and records are made of this.
    if isinstance(value, str):
        return _plain_text(value if type(value) is str else str.__str__(value))
    if value is None or isinstance(value, (int, float)):
        return _plain_number(value)
    if len(above) > _MAX_DEPTH:
        return f"<nested over {_MAX_DEPTH} deep>"
    if id(value) in above:
        return "<contains itself>"
    above = (*above, id(value))
    if isinstance(value, (dict, Mapping)):
        plain = {str(key): to_plain(part, images, above) for key, part in value.items()}
        return {_PLAIN_KEY: plain} if len(plain) == 1 and not _MARKS.isdisjoint(plain) else plain
    if isinstance(value, (list, tuple)):
        return [to_plain(part, images, above) for part in value]
    if isinstance(value, set | frozenset):
        return sorted((to_plain(part, images, above) for part in value), key=repr)
    if isinstance(value, np.ndarray | np.generic):
        return to_plain(value.tolist(), images, above)
    if hasattr(value, "tobytes") and hasattr(value, "mode") and hasattr(value, "size"):
        return {_IMAGE_KEY: image_name(value) if images is None else images.write(value)}
    return _shown(value)


def from_plain(value: Any, images: ImageFolder | None = None) -> Any:
    """Return what ``to_plain`` was given, images read from their files."""
    if isinstance(value, dict):
        if len(value) == 1 and not _MARKS.isdisjoint(value):
            return _marked(value, images)
        return {key: from_plain(part, images) for key, part in value.items()}
    if isinstance(value, list):
        return [from_plain(part, images) for part in value]
    return value


def _plain_number(number: float | None) -> Any:
    if isinstance(number, float):
        return float(number) if math.isfinite(number) else repr(float(number))
    # Python refuses to write or read longer numbers in decimals.
    return number if number is None or number.bit_length() <= _MAX_BITS else hex(number)


def _shown(value: object) -> Any:
    try:
        return _plain_text(repr(value)[:1000])
    except Exception:  # noqa: BLE001 - third-party code may raise anything
        return f"<{type(value).__name__}>"


def _plain_text(text: str) -> Any:
    if text.isascii():
        return text
    pieces = _BETWEEN_SURROGATES.split(text)
    return text if len(pieces) == 1 else {_TEXT_KEY: pieces}


def _marked(value: dict[str, Any], images: ImageFolder | None) -> Any:
    ((mark, content),) = value.items()
    if mark == _TEXT_KEY:
        return "".join(content)
    if mark == _PLAIN_KEY:
        return {key: from_plain(part, images) for key, part in content.items()}
    return value if images is None else images.read(content)
