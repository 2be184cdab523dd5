"""``GEOMETRY_SAMPLE``: problems whose figures are drawn when they are asked, the same every time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import count
from random import Random
from typing import TYPE_CHECKING, Any, Unpack, overload

from gem_core.errors import ArgumentError
from gem_math.figures import plots, shapes, triangles
from gem_math.figures.env import FigureEnv, FigureOptions

if TYPE_CHECKING:
    from gem_math.figures.drawn import Drawn

KINDS = (*triangles.KINDS, *shapes.KINDS, *plots.KINDS)
EACH = 5
"""Problems of each kind."""


class GeometrySample(Sequence[dict[str, Any]]):
    """Rows with the columns ``problem``, ``answer`` and ``images``, as those of ``math:Geometry3K``, and ``kind``."""

    def __len__(self) -> int:
        return EACH * len(KINDS)

    @overload
    def __getitem__(self, place: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, place: slice) -> list[dict[str, Any]]: ...
    def __getitem__(self, place: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        if isinstance(place, slice):
            return [self[index] for index in range(*place.indices(len(self)))]
        if not -len(self) <= place < len(self):
            raise IndexError(f"there are {len(self)} rows, and none at {place}")
        place %= len(self)
        row, kind = divmod(place, len(KINDS))
        drawn = _drawn(KINDS[kind])[row]
        image = drawn.image.copy()  # so that nobody draws into another's
        return {
            "problem": drawn.problem,
            "answer": drawn.answer,
            "images": [image],
            "kind": KINDS[kind].__name__,
        }


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


GEOMETRY_SAMPLE = GeometrySample()
"""One for all environments of a process."""


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
