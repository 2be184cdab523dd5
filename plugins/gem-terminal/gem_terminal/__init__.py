"""Terminal tasks in containers: a plugin of GEM. ``TerminalEnv`` runs any folder of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gem_core.errors import refuse_windows

if TYPE_CHECKING:
    from gem_terminal.terminal_env import TerminalEnv

__all__ = ["TerminalEnv"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load them.
    if name == "TerminalEnv":
        refuse_windows("a terminal task")
        from gem_terminal.terminal_env import TerminalEnv

        return TerminalEnv
    raise AttributeError(f"module 'gem_terminal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
