"""Checks of the contracts of environments, tools, wrappers, agents, commands, backends and plugins.

::

    from gem_core.testing import check_env

    def test_my_env_keeps_the_contract():
        check_env("mine:MyEnv-v0")

``check_tool``, ``check_wrapper``, ``check_agent``, ``check_command``, ``check_backend`` and ``check_plugin`` do the
same for the things in their names, and
``pytest --gem-envs 'mine:*'`` runs ``check_env`` on each environment that matches.

Neither pytest nor hypothesis is needed. Every promise is one function: see ``promises.py`` and ``promises_agents.py``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_core.testing.checks import check_agent, check_backend, check_command, check_wrapper
    from gem_core.testing.conformance import check_env
    from gem_core.testing.contract import ContractError, Report
    from gem_core.testing.findings import CheckError
    from gem_core.testing.hostile import hostile_actions
    from gem_core.testing.plugin_check import check_plugin
    from gem_core.testing.tool_check import check_tool

_NAMES_OF = {
    "checks": ("check_agent", "check_backend", "check_command", "check_wrapper"),
    "conformance": ("check_env",),
    "contract": ("ContractError", "Report"),
    "findings": ("CheckError",),
    "hostile": ("hostile_actions",),
    "plugin_check": ("check_plugin",),
    "tool_check": ("check_tool",),
}

__all__ = [
    "CheckError",
    "ContractError",
    "Report",
    "check_agent",
    "check_backend",
    "check_command",
    "check_env",
    "check_plugin",
    "check_tool",
    "check_wrapper",
    "hostile_actions",
]


def __getattr__(name: str) -> Any:
    # Lazy, so that the interpreter which checks what a plugin imports has imported nothing but the standard library.
    for module, names in _NAMES_OF.items():
        if name in names:
            return getattr(importlib.import_module(f"gem_core.testing.{module}"), name)
    raise AttributeError(f"module 'gem_core.testing' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
