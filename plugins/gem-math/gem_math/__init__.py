"""Mathematics with verified answers: a plugin of GEM."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_math.grading import Grade, grade
    from gem_math.math_env import MathEnv

__all__ = ["Grade", "MathEnv", "grade"]

_HOMES = {"Grade": "gem_math.grading", "MathEnv": "gem_math.math_env", "grade": "gem_math.grading"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: that a plugin is found must load nothing."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    value = globals()[name] = getattr(importlib.import_module(home), name)
    return value
