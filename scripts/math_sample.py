"""For authors of math:Sample and math:GeometrySample, after a change of ``math_problems``: write the data.

``python scripts/math_sample.py`` writes plugins/gem-math/gem_math/data. A test compares the two.

A family of problems draws its numbers, works the answer out in exact arithmetic, and proves it in another way, as by
putting it into the equation. Figures are the same wherever Pillow is.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

from math_problems import algebra, measures, numbers, plots, shapes, triangles
from math_problems.problems import Draw, Family, Problem
from PIL import Image

if TYPE_CHECKING:
    from math_problems.drawn import Drawn

DATA = Path(__file__).resolve().parent.parent / "plugins" / "gem-math" / "gem_math" / "data"
FAMILIES = (*numbers.FAMILIES, *algebra.FAMILIES, *measures.FAMILIES)
KINDS = (*triangles.KINDS, *shapes.KINDS, *plots.KINDS)
EACH = 5
"""Problems of each family, and of each kind of figure."""

_COLOURS = 256


def main() -> None:
    """Write both files."""
    DATA.mkdir(exist_ok=True)
    for name, rows in (("sample.jsonl", text_rows()), ("geometry.jsonl", figure_rows())):
        target = DATA / name
        target.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
        print(f"{target.stat().st_size:,} bytes in {target}")


def text_rows() -> Iterator[dict[str, str]]:
    """Give the rows of math:Sample, with the columns ``id``, ``problem``, ``answer`` and ``form``."""
    for family in FAMILIES:
        yield from _rows_of(family)


def _rows_of(family: Family) -> list[dict[str, str]]:
    draw = Draw(family.__name__)
    found: dict[str, Problem] = {}
    while len(found) < EACH:
        problem = family(draw)
        found.setdefault(problem.statement, problem)
    return [
        {"id": f"{family.__name__}-{number}", "problem": each.statement, "answer": each.answer, "form": each.form}
        for number, each in enumerate(found.values())
    ]


def figure_rows() -> Iterator[dict[str, Any]]:
    """Give the rows of math:GeometrySample, a problem of each kind after another; images are ``data:`` addresses."""
    drawn = [_drawn(kind) for kind in KINDS]
    for row in range(EACH):
        for kind, problems in zip(KINDS, drawn, strict=True):
            each = problems[row]
            yield {
                "problem": each.problem,
                "answer": each.answer,
                "images": [f"data:image/png;base64,{base64.b64encode(as_png(each.image)).decode()}"],
                "kind": kind.__name__,
            }


def _drawn(kind: Callable[[Random], Drawn]) -> list[Drawn]:
    found: dict[bytes, Drawn] = {}
    for number in count():
        drawn = kind(Random(f"{kind.__name__} {number}"))
        found.setdefault(drawn.image.tobytes(), drawn)
        if len(found) == EACH:
            break
    return list(found.values())


def as_png(image: Image.Image) -> bytes:
    """Return an image as a file of the same pixels, with a palette where its colours fit into one."""
    data = image.tobytes()
    pixels = [data[at : at + 3] for at in range(0, len(data), 3)]
    colours = sorted(set(pixels))
    if len(colours) <= _COLOURS:
        places = {colour: place for place, colour in enumerate(colours)}
        small = Image.new("P", image.size)
        small.putpalette(b"".join(colours))
        small.putdata([places[pixel] for pixel in pixels])
        image = small
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


if __name__ == "__main__":
    main()
