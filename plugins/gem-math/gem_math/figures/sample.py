"""``GEOMETRY_SAMPLE``: problems whose figures are drawn when they are asked, the same every time."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import count
from random import Random
from typing import TYPE_CHECKING, Any, Unpack

from gem_core.data import Rows
from gem_core.errors import ArgumentError
from gem_math.figures import plots, shapes, triangles
from gem_math.figures.env import FigureEnv, FigureOptions

if TYPE_CHECKING:
    from gem_math.figures.drawn import Drawn

KINDS = (*triangles.KINDS, *shapes.KINDS, *plots.KINDS)
EACH = 5
"""Problems of each kind."""


@cache
def _drawn(kind: Callable[[Random], Drawn]) -> list[Drawn]:
    """Return the problems of a kind; what was drawn already is not drawn again."""
    found: dict[bytes, Drawn] = {}
    for number in count():
        drawn = kind(Random(f"{kind.__name__} {number}"))
        found.setdefault(drawn.image.tobytes(), drawn)
        if len(found) == EACH:
            break
    return list(found.values())


def _row(place: int) -> dict[str, Any]:
    row, kind = divmod(place, len(KINDS))
    drawn = _drawn(KINDS[kind])[row]
    return {
        "problem": drawn.problem,
        "answer": drawn.answer,
        "images": [drawn.image.copy()],  # so that nobody draws into another's
        "kind": KINDS[kind].__name__,
    }


GEOMETRY_SAMPLE = Rows(range(EACH * len(KINDS)), _row)
"""Rows with the columns ``problem``, ``answer`` and ``images``, as those of ``math:Geometry3K``, and ``kind``."""


class GeometrySampleEnv(FigureEnv):
    """``math:GeometrySample``: its rows are its own.

    Args:
        **options: See ``FigureEnv``.

    Raises:
        ArgumentError: Other rows were given.
    """

    def __init__(self, **options: Unpack[FigureOptions]) -> None:
        if options.get("dataset_name") is not None:
            raise ArgumentError("math:GeometrySample has its own rows; others go to gem_math.figures.env:FigureEnv")
        super().__init__(GEOMETRY_SAMPLE, **options)
