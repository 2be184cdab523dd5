"""Question answering and logic: a plugin of GEM. ``QAEnv`` asks the rows of any data set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_qa.env import QAEnv

__all__ = ["QAEnv"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load them.
    if name == "QAEnv":
        from gem_qa.env import QAEnv

        return QAEnv
    raise AttributeError(f"module 'gem_qa' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
