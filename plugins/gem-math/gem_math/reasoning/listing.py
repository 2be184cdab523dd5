"""The ids under ``rg:``; imports nothing of reasoning-gym."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from gem_core.registry import EnvSpec

TASKS: dict[str, str] = json.loads((Path(__file__).parents[1] / "data/reasoning_tasks.json").read_text("utf-8"))
"""The category of each task of reasoning-gym 0.1.25, by its name; made by scripts/list_reasoning_tasks.py."""
_ENTRY_POINT = "gem_math.reasoning.env:ReasoningGymEnv"
_REQUIRES = ("package:gem-math[reasoning-gym]",)


def reasoning_specs() -> Iterator[EnvSpec]:
    """Return a record for each task, and one for the mixture of several."""
    for name, category in TASKS.items():
        yield EnvSpec(
            id=f"rg:{name}",
            entry_point=_ENTRY_POINT,
            kwargs={"task": name},
            summary=f"ReasoningGym's {name.replace('_', ' ')}, of its category {category}.",
            tags=("reasoning", "text", category),
            requires=_REQUIRES,
        )
    yield EnvSpec(
        id="rg:composite",
        entry_point=_ENTRY_POINT,
        kwargs={"task": "composite"},
        summary="Several tasks of ReasoningGym mixed by weight; all of them unless told.",
        tags=("reasoning", "text", "mixture"),
        requires=_REQUIRES,
    )
