"""``FigureEnv``: a problem with images, from the rows of a data set."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Unpack

from gem_core.data import DatasetOptions
from gem_core.env import Content
from gem_core.errors import DatasetError
from gem_core.suggestions import did_you_mean
from gem_core.types import Observation
from gem_math.figures.images import images_of
from gem_math.math_env import MathEnv

if TYPE_CHECKING:
    from gymnasium import spaces

PLACE = "<image>"
"""What stands for an image in the text of a problem."""


PROMPT = "{question}\n\nWrite your final answer in \\boxed{}."


class FigureOptions(DatasetOptions, total=False):
    """The keywords of ``MathEnv``, but for the rows."""

    answer_after: str | None
    format_reward: float
    format_error_reward: float
    length_penalty: float
    partial_credit: bool
    timeout_s: float


class FigureEnv(MathEnv):
    r"""Asks a problem with images: the observation is a list of content parts, and answers are graded as ``MathEnv``'s.

    A right answer has the reward 1, anything else 0, unless keywords of ``MathEnv`` change that.

    Each ``<image>`` in the prompt stands for the next image of the row; images that no place is left for come first.

    Args:
        rows: As for ``DatasetEnv``.
        image_key: Column of the images: one or a list, each a PIL image, a path, a ``data:`` address in base 64, the
            bytes of a file, or ``{"bytes": …, "path": …}``. A row without any is asked as text.
        **options: Keywords of ``MathEnv``; unless told, ``question_key`` is ``"problem"``, and ``prompt_template`` asks
            for a box.

    Raises:
        DatasetError: The data set has no such column, or an image of a row cannot be read; the message names the row.
    """

    def __init__(
        self,
        rows: Any = None,
        *,
        image_key: str = "images",
        **options: Unpack[FigureOptions],
    ) -> None:
        self.image_key = image_key
        options.setdefault("question_key", "problem")
        options.setdefault("prompt_template", PROMPT)
        super().__init__(rows, **options)
        first = self.rows[0]
        if image_key not in first:
            columns = ", ".join(map(repr, first))
            raise DatasetError(
                f"no column {image_key!r} in the data set.{did_you_mean(image_key, first)} Columns: {columns}"
            )

    @cached_property
    def observation_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """Content parts."""
        return Content()

    def prompt(self, row: Mapping[str, Any]) -> Observation:
        """Return the problem as content parts.

        Raises:
            DatasetError: An image cannot be read, or the text has more places than there are images.
        """
        text = str(super().prompt(row))
        images = images_of(row.get(self.image_key), self._index, self.image_key)
        pieces = text.split(PLACE)
        places = len(pieces) - 1
        if places > len(images):
            raise DatasetError(
                f"row {self._index} has {places} places for images in its text, and {len(images)} in {self.image_key!r}"
            )
        spare = len(images) - places
        parts = [{"type": "image", "image": image} for image in images[:spare]]
        for number, piece in enumerate(pieces):
            if number:
                parts.append({"type": "image", "image": images[spare + number - 1]})
            if piece.strip():
                parts.append({"type": "text", "text": piece.strip("\n") if places else piece})
        return parts
