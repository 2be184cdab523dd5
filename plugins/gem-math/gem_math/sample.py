"""``math:Sample``: problems with answers in many forms, made by code, so that everything works without a download.

The families are in the modules ``sample_*``. A family draws its numbers, works the answer out in exact arithmetic, and
proves it in another way, as by putting it into the equation. The rows are the same everywhere: a test pins them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from gem_core.errors import ArgumentError
from gem_math.math_env import MathEnv
from gem_math.sample_algebra import FAMILIES as ALGEBRA
from gem_math.sample_numbers import FAMILIES as NUMBERS
from gem_math.sample_problems import Draw, Family
from gem_math.sample_shapes import FAMILIES as SHAPES

_OF_EACH = 5
_FIXED = ("dataset_name", "split", "config", "revision")


class SampleEnv(MathEnv):
    """Asks a problem of the sample: ``MathEnv`` on the rows of ``sample_rows``.

    Args:
        **options: Keywords of ``MathEnv`` but for those that say where rows come from.
    """

    def __init__(self, **options: Any) -> None:
        given = [name for name in (*_FIXED, "rows") if options.get(name) is not None]
        if given:
            raise ArgumentError(f"math:Sample has its own rows: leave out {given[0]!r}, or use gem_math:MathEnv")
        super().__init__(sample_rows(), id_key="id", question_key="problem", **options)


@lru_cache(maxsize=1)
def sample_rows() -> tuple[dict[str, str], ...]:
    """Return the rows, with the columns ``id``, ``problem``, ``answer`` and ``form``."""
    rows = []
    for family in (*NUMBERS, *ALGEBRA, *SHAPES):
        rows += _rows_of(family)
    return tuple(rows)


def _rows_of(family: Family) -> list[dict[str, str]]:
    name = family.__name__
    rows: list[dict[str, str]] = []
    seen: set[str] = set()
    draw = Draw(name)
    while len(rows) < _OF_EACH:
        problem = family(draw)
        if problem.statement in seen:
            continue
        seen.add(problem.statement)
        row = {
            "id": f"{name}-{len(rows)}",
            "problem": problem.statement,
            "answer": problem.answer,
            "form": problem.form,
        }
        rows.append(row)
    return rows
