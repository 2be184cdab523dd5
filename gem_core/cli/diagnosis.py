"""What ``gem doctor`` finds out: versions, plugins, what is broken, how tools stand, which requirements are met."""

from __future__ import annotations

import importlib.machinery
import importlib.metadata
import importlib.util
import json
import logging
import os
import platform
import queue
import re
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gem_core import __version__
from gem_core.plugins import Plugin
from gem_core.registry import Registry, registry
from gem_core.requirements import SERVICES, find, installed_version, which_gem
from gem_core.specs import EnvSpec, ToolSpec

PACKAGES = ("gymnasium", "numpy", "pydantic", "pluggy", "click", "rich")
"""What the core is built on; their versions belong into every report of a bug."""

_OF_EXTRA = re.compile(r"""([\w.-]+).*;.*\bextra\s*==\s*["']([\w.-]+)["']""")


def diagnose() -> dict[str, Any]:
    """Return all that is known of this installation, as plain JSON.

    ``broken`` lists in one line each what is installed and cannot work. No value of a key is in it.
    """
    notes = _load_quietly()
    found = registry()
    plugins = found.plugins()
    dangling = dangling_entry_points(plugins)
    broken = [
        f"{plugin} failed at stage '{plugin.failure.stage}': {plugin.failure.error}"
        for plugin in plugins
        if plugin.failure is not None
    ]
    tools = tool_statuses(found)
    unknown = [f"the status of tool {tool['tool']!r} failed: {tool['error']}" for tool in tools if tool["error"]]
    return {
        "gem_core": __version__,
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "packages": {name: installed_version(name) for name in PACKAGES},
        "plugins": [described(plugin) for plugin in plugins],
        "contested": found.contested(),
        "broken": [*broken, *dangling, *unknown],
        "tools": tools,
        "requirements": requirements(found),
        "extras": _extras(),
        "command": vars(which_gem()),
        "runs": _runs_folder(),
        "notes": notes,
    }


def described(plugin: Plugin) -> dict[str, Any]:
    """Return a plugin, what it offers and what is wrong with it, as plain JSON."""
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "disabled": plugin.disabled,
        "load_time_ms": round(plugin.load_time_s * 1000, 3),
        "offers": dict(offers(plugin)),
        "failure": None if plugin.failure is None else vars(plugin.failure),
    }


def offers(plugin: Plugin) -> Counter[str]:
    """Return how many records of each kind a plugin offers."""
    return Counter("environment" if isinstance(record, EnvSpec) else record.kind for record in plugin.records)


def listed(plugin: Plugin | dict[str, Any]) -> str:
    """Return what a plugin offers in words: "2 environments, 1 tool"."""
    counts = offers(plugin) if isinstance(plugin, Plugin) else plugin["offers"]
    return ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in counts.items()) or "offers nothing"


def requirements(found: Registry) -> list[dict[str, Any]]:
    """Return every requirement of an environment, with what is known of it, those to act on first.

    The services of the machine are in it whether an environment needs them or not.
    """
    needing: dict[str, list[str]] = {service: [] for service in SERVICES}
    for record in found.envs():
        for requirement in record.requires:
            needing.setdefault(requirement, []).append(record.id)
    rows = [
        {
            "requirement": requirement,
            **vars(find(requirement, closely=True)),
            "environments": len(ids),
            "example": ids[0] if ids else None,
        }
        for requirement, ids in needing.items()
    ]
    order = ["unmet", "unknown", "untried", "met"]
    return sorted(rows, key=lambda row: (not row["environments"], order.index(row["status"])))


def tool_statuses(found: Registry, timeout_s: float = 30.0) -> list[dict[str, Any]]:
    """Return every tool with what it says of itself on this machine, each asked in its own guard.

    Args:
        found: Where the tools are.
        timeout_s: Seconds after which an answer is no longer waited for.
    """
    return [
        {"tool": record.name, "summary": record.summary, "status": status, "error": error}
        for record in found.named(ToolSpec)
        for status, error in [_status_of(record, timeout_s)]
    ]


def _status_of(record: ToolSpec, timeout_s: float) -> tuple[Any, str | None]:
    """Return what a tool says of itself, and what is wrong with that."""
    from gem_core.entry_points import load_entry_point

    entry_point = record.status
    if entry_point is None:
        return None, None
    answers: queue.SimpleQueue[tuple[Any, str | None]] = queue.SimpleQueue()

    def ask() -> None:
        try:
            status = load_entry_point(entry_point, f"the status of tool {record.name!r}")()
            if not isinstance(status, str | Mapping):
                raise TypeError(f"it returned {type(status).__name__}, neither a line of text nor a mapping")
            plain = status if isinstance(status, str) else {str(key): value for key, value in status.items()}
            answers.put((json.loads(json.dumps(plain, default=str)), None))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - somebody else's code, which may fail in any way
            answers.put((None, f"{type(error).__name__}: {error}"[:500]))

    # In a thread, so that one that hangs does not hold up the report, nor the end of the program.
    threading.Thread(target=ask, name=f"gem-status-{record.name}", daemon=True).start()
    try:
        return answers.get(timeout=timeout_s)
    except queue.Empty:
        return None, f"it did not answer within {timeout_s:g} s"


def dangling_entry_points(plugins: Iterable[Plugin]) -> list[str]:
    """Return one line for each record whose module is not there, found without importing any implementation."""
    missing: dict[tuple[str, str], list[str]] = {}
    there: dict[str, bool] = {}
    for plugin in plugins:
        for record in plugin.records:
            if not isinstance(record.entry_point, str):
                continue
            module = record.entry_point.partition(":")[0]
            if module not in there:
                there[module] = _is_there(module)
            needs = record.requires if isinstance(record, EnvSpec) else ()
            if not there[module] and all(find(requirement).status != "unmet" for requirement in needs):
                name = record.id if isinstance(record, EnvSpec) else f"{record.kind} {record.name}"
                missing.setdefault((str(plugin), module), []).append(name)
    return [
        f"{plugin} points to the module {module!r}, which is not there: {names[0]}"
        + (f" (and {len(names) - 1} more)" if len(names) > 1 else "")
        for (plugin, module), names in missing.items()
    ]


def _is_there(module: str) -> bool:
    if module in sys.modules:
        return True
    # importlib.util.find_spec would import the parent packages of a dotted name, which may be heavy.
    top, *rest = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
        name = top
        for part in rest:
            if spec is None or spec.submodule_search_locations is None:
                return False
            name = f"{name}.{part}"
            spec = importlib.machinery.PathFinder.find_spec(name, list(spec.submodule_search_locations))
    except Exception:  # noqa: BLE001 - finders of others may fail in any way; make will tell then
        return True
    return spec is not None


def _load_quietly() -> list[str]:
    """Load the plugins and return what was logged, but for the failures: a report shows those in full."""
    logger = logging.getLogger("gem_core")
    notes: list[str] = []

    def keep(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.WARNING:
            message = record.getMessage()
            if not message.startswith("gem: plugin "):
                notes.append(message.removeprefix("gem: "))
        return False

    strict = os.environ.pop("GEM_PLUGINS_STRICT", None)  # it would stop at the first failure, and all are wanted
    logger.addFilter(keep)
    try:
        registry().load()
    finally:
        logger.removeFilter(keep)
        if strict is not None:
            os.environ["GEM_PLUGINS_STRICT"] = strict
    return notes


def _extras() -> list[dict[str, Any]]:
    """Return the optional extras of gem-core, each with its packages and their versions."""
    try:
        lines = importlib.metadata.requires("gem-core") or []
    except importlib.metadata.PackageNotFoundError:  # run from a folder, without an installation
        lines = []
    extras: dict[str, dict[str, str | None]] = {}
    for match in filter(None, map(_OF_EXTRA.match, lines)):
        extras.setdefault(match[2], {})[match[1]] = installed_version(match[1])
    return [
        {"extra": extra, "packages": packages, "present": all(packages.values())} for extra, packages in extras.items()
    ]


def _runs_folder() -> dict[str, Any]:
    runs = Path("runs")
    if not runs.exists():
        writable = os.access(".", os.W_OK | os.X_OK)
        return {"status": "met" if writable else "unmet", "detail": "can be made" if writable else "cannot be made"}
    writable = runs.is_dir() and os.access(runs, os.W_OK | os.X_OK)
    return {"status": "met" if writable else "unmet", "detail": "is writable" if writable else "cannot be written to"}
