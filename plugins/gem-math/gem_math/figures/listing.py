"""The ids of problems with figures; draws none."""

from __future__ import annotations

from collections.abc import Iterator

from gem_core.registry import EnvSpec


def figure_specs() -> Iterator[EnvSpec]:
    """Return a record for each data set."""
    yield EnvSpec(
        id="math:GeometrySample",
        entry_point="gem_math.figures.sample:GeometrySampleEnv",
        summary="Geometry and charts from figures drawn on the spot; 115 problems, offline.",
        tags=("math", "image"),
    )
    yield EnvSpec(
        id="math:Geometry3K",
        entry_point="gem_math.figures.env:FigureEnv",
        kwargs={"dataset_name": "axon-rl/geometry3k", "split": "train"},
        summary="Geometry problems with figures.",
        tags=("math", "image"),
        requires=("hub",),
    )
