"""Images in rows of tokens: the ids that stand for them, and a small encoder that makes vectors of these."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn import functional as F

if TYPE_CHECKING:
    from PIL.Image import Image

_SIDE, _PLACES = 32, 16
"""Pixels of a side that an image is resized to, and vectors that the encoder makes of it: 4 by 4 places."""


class Pictures:
    """The images of a batch of episodes, with the ids of their places in rows.

    Equal images have equal ids and different ones different ids: so what rows have in common is found by ids alone,
    with images or without.

    Args:
        words: Number of entries of the vocabulary; ids of images follow theirs.
    """

    def __init__(self, words: int) -> None:
        self.words = words
        self._numbers: dict[bytes, int] = {}
        self._pixels: list[Tensor] = []

    def __len__(self) -> int:
        return len(self._pixels)

    def ids(self, image: Image) -> list[int]:
        """Return the ids of an image's places."""
        pixels = image.convert("RGB").resize((_SIDE, _SIDE)).tobytes()
        number = self._numbers.setdefault(pixels, len(self._numbers))
        if number == len(self._pixels):
            self._pixels.append(torch.frombuffer(bytearray(pixels), dtype=torch.uint8).view(_SIDE, _SIDE, 3))
        first = self.words + number * _PLACES
        return list(range(first, first + _PLACES))

    def look_up(self, ids: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the images that some ids stand for, and of each id, which of these it is, and its place there.

        Args:
            ids: (n,), of images.

        Returns:
            Images, from -1 to 1, (m, 3, side, side); for each id the number of its image among these, (n,), and the
            place, (n,).
        """
        numbers, index = torch.unique((ids - self.words) // _PLACES, return_inverse=True)
        pixels = torch.stack([self._pixels[number] for number in numbers.tolist()])
        return pixels.permute(0, 3, 1, 2) / 127.5 - 1, index, (ids - self.words) % _PLACES


class ImageEncoder(nn.Module):
    """Three convolutions, each of which halves the side.

    Args:
        width: Of the vectors.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = nn.Conv2d(3, 16, 4, stride=2, padding=1), nn.Conv2d(16, 16, 4, stride=2, padding=1)
        self.last = nn.Conv2d(16, width, 2, stride=2)

    def forward(self, images: Tensor) -> Tensor:
        """Return the vectors of images, (images, places, width)."""
        vectors: Tensor = self.last(F.gelu(self.second(F.gelu(self.first(images)))))
        return vectors.flatten(2).transpose(1, 2)
