"""What this distribution offers; it imports no task and no grader."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import EnvSpec, hookimpl
from gem_math.figures.listing import figure_specs
from gem_math.listing import math_specs
from gem_math.reasoning.listing import reasoning_specs


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The data sets of problems, and the tasks of ReasoningGym."""
    yield from math_specs()
    yield from figure_specs()
    yield from reasoning_specs()
