"""The checks of ``gem doctor``: versions, plugins, status of tools and requirements."""

from __future__ import annotations

import asyncio
import json
import os
import platform
import sys
from collections import Counter
from collections.abc import Mapping
from typing import Any

from gem_core import __version__
from gem_core.background import in_thread, run_sync
from gem_core.cli.layout import counted
from gem_core.progress import Progress
from gem_core.registry.distributions import installed_version
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import Registry, registry
from gem_core.registry.plugins import Plugin, one_line
from gem_core.registry.requirements import RequirementStatus, find
from gem_core.registry.specs import EnvSpec, ToolSpec
from gem_core.testing.plugin_check import inspect_plugin

PACKAGES = ("gymnasium", "numpy", "pydantic", "pluggy", "click", "rich")
"""Dependencies of the core, whose versions belong in every bug report."""


def diagnose(*, quick: bool = False) -> dict[str, Any]:
    """Describe this installation as plain JSON.

    ``broken`` lists in one line each what is installed and cannot work. No value of a key is in it.

    Args:
        quick: Whether to leave out importing all that plugins point to, which takes seconds.
    """
    os.environ.pop("GEM_PLUGINS_STRICT", None)  # it would stop at the first failure, and all are wanted
    found = registry()
    plugins = found.plugins()
    broken: list[str] = []
    with Progress(len(plugins), "plugins", unit="plugins", quiet=not sys.stderr.isatty()) as progress:
        for number, plugin in enumerate(plugins):
            problems = problems_of(plugin, quick=quick)
            if plugin.failure is not None:
                problems.append(f"failed at stage '{plugin.failure.stage}': {plugin.failure.error}")
            broken += [f"{plugin}: {problem}" for problem in problems]
            progress.advance(number + 1)
    tools = [
        {"tool": record.name, "summary": record.summary, "status": status, "error": error}
        for record in found.specs(ToolSpec)
        for status, error in [status_of(record)]
    ]
    broken += [f"the status of tool {tool['tool']!r} failed: {tool['error']}" for tool in tools if tool["error"]]
    return {
        "gem_core": __version__,
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "packages": {name: installed_version(name) for name in PACKAGES},
        "plugins": [describe_plugin(plugin) for plugin in plugins],
        "tools": tools,
        "requirements": requirements(found),
        "broken": broken,
    }


def describe_plugin(plugin: Plugin) -> dict[str, Any]:
    """Describe a plugin, its records and its problems as plain JSON."""
    kinds = ("environment" if isinstance(record, EnvSpec) else record.kind for record in plugin.records)
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "disabled": plugin.disabled,
        "load_time_ms": round(plugin.load_time_s * 1000, 3),
        "offers": Counter(kinds),
        "failure": None if plugin.failure is None else vars(plugin.failure),
        "conflicts": plugin.conflicts,
    }


def offers_in_words(described_plugin: Mapping[str, Any]) -> str:
    """Return what a plugin offers as text: "2 environments, 1 tool"."""
    offers = described_plugin["offers"].items()
    return ", ".join(counted(number, kind) for kind, number in offers) or "offers nothing"


def requirements(found: Registry) -> list[dict[str, Any]]:
    """Return every requirement of an environment, with what is known of it, those to act on first."""
    needing: dict[str, list[str]] = {}
    for record in found.envs():
        for requirement in record.requires:
            needing.setdefault(requirement, []).append(record.id)
    rows = []
    for requirement, ids in needing.items():
        try:
            status = find(requirement, closely=True)
            facts = {**vars(status)}
        except Exception as error:  # noqa: BLE001 - a failing probe of a plugin must not end the report
            facts = vars(RequirementStatus("unknown", f"its probe failed: {one_line(error)}"))
        rows.append({"requirement": requirement, **facts, "environments": len(ids), "example": ids[0]})
    order = ["unmet", "unknown", "untried", "met"]
    return sorted(rows, key=lambda row: order.index(row["status"]))


def status_of(record: ToolSpec, timeout_s: float = 30.0) -> tuple[Any, str | None]:
    """Return the status of a tool on this machine, and the error of asking for it, if any.

    Args:
        record: Of the tool.
        timeout_s: Seconds after which an answer is no longer waited for.
    """
    entry_point = record.status
    if entry_point is None:
        return None, None

    def ask() -> Any:
        status = load_entry_point(entry_point, f"the status of tool {record.name!r}")()
        if not isinstance(status, str | Mapping):
            raise TypeError(f"it returned {type(status).__name__}, neither a line of text nor a mapping")
        return json.loads(json.dumps(status, default=str))

    try:
        return run_sync(asyncio.wait_for(in_thread(ask), timeout_s)), None
    except TimeoutError:
        return None, f"it did not answer within {timeout_s:g} s"
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin's code, which may fail in any way
        return None, f"{type(error).__name__}: {error}"[:500]


def status_line(status: Any) -> str:
    """Return the status of a tool in one line."""
    if isinstance(status, dict):
        status = ", ".join(f"{key}: {value}" for key, value in status.items())
    return " ".join(str(status or "").split())


def problems_of(plugin: Plugin, *, quick: bool = False) -> list[str]:
    """Return one line for each thing that is wrong with a plugin, though it loads.

    Args:
        plugin: The plugin, whose entry points are imported in another interpreter.
        quick: Whether to import nothing, and tell of conflicts only.
    """
    if quick or plugin.failure is not None or plugin.disabled or plugin.is_core:
        return [*plugin.conflicts]
    seen = inspect_plugin(plugin.entry_point)
    return [*plugin.conflicts, *([seen.failure] if seen.failure else seen.problems())]
