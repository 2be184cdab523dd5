"""Checks of the contracts of environments, tools, wrappers, agents, commands, backends and plugins.

::

    from gem_core.testing import check_env

    def test_my_env_keeps_the_contract():
        check_env("mine:MyEnv-v0")

``check_tool``, ``check_wrapper``, ``check_agent``, ``check_command``, ``check_backend`` and ``check_plugin`` do the
same for the things in their names, and
``pytest --gem-envs 'mine:*'`` runs ``check_env`` on each environment that matches.

Neither pytest nor hypothesis is needed. Every promise is one small function: see ``promises_*.py``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_core.testing.agent_check import check_agent
    from gem_core.testing.backend_check import check_backend
    from gem_core.testing.command_check import check_command
    from gem_core.testing.conformance import check_env
    from gem_core.testing.contract import ContractError, Report
    from gem_core.testing.findings import CheckError
    from gem_core.testing.hostile import hostile_actions
    from gem_core.testing.plugin_check import check_plugin
    from gem_core.testing.tool_check import check_tool
    from gem_core.testing.wrapper_check import check_wrapper

_MODULE_OF = {
    "check_agent": "agent_check",
    "check_backend": "backend_check",
    "check_command": "command_check",
    "check_env": "conformance",
    "check_plugin": "plugin_check",
    "check_tool": "tool_check",
    "check_wrapper": "wrapper_check",
    "CheckError": "findings",
    "ContractError": "contract",
    "Report": "contract",
    "hostile_actions": "hostile",
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
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'gem_core.testing' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"gem_core.testing.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
