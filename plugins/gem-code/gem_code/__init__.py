"""Programming problems, graded by tests in a sandbox: a plugin of GEM. ``CodeEnv`` asks the rows of any data set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_code.code_env import CodeEnv

__all__ = ["CodeEnv"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load them.
    if name == "CodeEnv":
        from gem_code.code_env import CodeEnv

        return CodeEnv
    raise AttributeError(f"module 'gem_code' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
