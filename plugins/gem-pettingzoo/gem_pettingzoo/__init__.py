"""To and from PettingZoo's environments of several agents: a plugin of GEM."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_pettingzoo.exports import to_aec, to_parallel
    from gem_pettingzoo.imports import PettingZooEnv, from_pettingzoo

__all__ = ["PettingZooEnv", "from_pettingzoo", "to_aec", "to_parallel"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load PettingZoo.
    if name in ("PettingZooEnv", "from_pettingzoo"):
        from gem_pettingzoo import imports

        return getattr(imports, name)
    if name in ("to_aec", "to_parallel"):
        from gem_pettingzoo import exports

        return getattr(exports, name)
    raise AttributeError(f"module 'gem_pettingzoo' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
