"""The checks of ``gem doctor``: versions, plugins, failures, status of tools and requirements."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import platform
import shutil
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from gem_core import __version__
from gem_core.background import in_thread, run_sync
from gem_core.cli.layout import counted
from gem_core.progress import Progress
from gem_core.registry.distributions import extras_of, installed_version
from gem_core.registry.lookup import Registry, registry
from gem_core.registry.plugins import Plugin, Record, one_line
from gem_core.registry.requirements import RequirementStatus, find
from gem_core.registry.specs import EnvSpec, RequirementSpec, ToolSpec
from gem_core.testing.importing import TIMEOUT_S, imported

PACKAGES = ("gymnasium", "numpy", "pydantic", "pluggy", "click", "rich")
"""Dependencies of the core, whose versions belong in every bug report."""


def diagnose(*, quick: bool = False) -> dict[str, Any]:
    """Describe this installation as plain JSON.

    ``broken`` lists in one line each what is installed and cannot work. No value of a key is in it.

    Args:
        quick: Whether to leave out importing all that plugins point to, which takes seconds.
    """
    notes = _load_quietly()
    found = registry()
    plugins = found.plugins()
    problems: list[str] = []
    with Progress(len(plugins), "plugins", unit="plugins", quiet=not sys.stderr.isatty()) as progress:
        for number, (plugin, wrong) in enumerate(problems_of(plugins, quick=quick)):
            problems += [f"{plugin}: {each}" for each in wrong]
            progress.advance(number + 1)
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
        "plugins": [describe_plugin(plugin) for plugin in plugins],
        "broken": [*broken, *problems, *unknown],
        "tools": tools,
        "requirements": requirements(found),
        "extras": _extras(),
        "command": vars(which_gem()),
        "notes": notes,
    }


def describe_plugin(plugin: Plugin) -> dict[str, Any]:
    """Describe a plugin, its records and its problems as plain JSON."""
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "disabled": plugin.disabled,
        "load_time_ms": round(plugin.load_time_s * 1000, 3),
        "offers": Counter(_kind_of(record) for record in plugin.records),
        "failure": None if plugin.failure is None else vars(plugin.failure),
        "conflicts": plugin.conflicts,
    }


def _kind_of(record: Record) -> str:
    return "environment" if isinstance(record, EnvSpec) else record.kind


def offers_in_words(described_plugin: Mapping[str, Any]) -> str:
    """Return what a plugin offers as text: "2 environments, 1 tool"."""
    offers = described_plugin["offers"].items()
    return ", ".join(counted(number, kind) for kind, number in offers) or "offers nothing"


def requirements(found: Registry) -> list[dict[str, Any]]:
    """Return every requirement of an environment, with what is known of it, those to act on first.

    What plugins offer a probe for, the hub and the network are in it whether an environment needs them or not.
    """
    needing: dict[str, list[str]] = {}
    for record in found.envs():
        for requirement in record.requires:
            needing.setdefault(requirement, []).append(record.id)
    words = {requirement.partition(":")[0] for requirement in needing}
    for word in [*(record.name for record in found.named(RequirementSpec)), "hub", "network"]:
        if word not in words:
            needing[word] = []
    rows = [
        {
            "requirement": requirement,
            **vars(_probed(requirement)),
            "environments": len(ids),
            "example": ids[0] if ids else None,
        }
        for requirement, ids in needing.items()
    ]
    order = ["unmet", "unknown", "untried", "met"]
    return sorted(rows, key=lambda row: (not row["environments"], order.index(row["status"])))


def _probed(requirement: str) -> RequirementStatus:
    try:
        status = find(requirement, closely=True)
        if not isinstance(status, RequirementStatus):
            raise TypeError(f"it returned {type(status).__name__}")
    except Exception as error:  # noqa: BLE001 - a failing probe of a plugin must not end the report
        return RequirementStatus("unknown", f"its probe failed: {one_line(error)}")
    return status


def tool_statuses(found: Registry, timeout_s: float = 30.0) -> list[dict[str, Any]]:
    """Return every tool with its status on this machine; the failure of one does not affect the others.

    Args:
        found: Where the tools are.
        timeout_s: Seconds after which an answer is no longer waited for.
    """
    return [
        {"tool": record.name, "summary": record.summary, "status": status, "error": error}
        for record in found.named(ToolSpec)
        for status, error in [status_of(record, timeout_s)]
    ]


def status_line(status: Any) -> str:
    """Return the status of a tool in one line."""
    if isinstance(status, dict):
        status = ", ".join(f"{key}: {value}" for key, value in status.items())
    return " ".join(str(status or "").split())


def status_of(record: ToolSpec, timeout_s: float = 30.0) -> tuple[Any, str | None]:
    """Return the status of a tool on this machine, and the error of asking for it, if any.

    Args:
        record: Of the tool.
        timeout_s: Seconds after which an answer is no longer waited for.
    """
    from gem_core.registry.entry_points import load_entry_point

    entry_point = record.status
    if entry_point is None:
        return None, None

    def ask() -> tuple[Any, str | None]:
        try:
            status = load_entry_point(entry_point, f"the status of tool {record.name!r}")()
            if not isinstance(status, str | Mapping):
                raise TypeError(f"it returned {type(status).__name__}, neither a line of text nor a mapping")
            plain = status if isinstance(status, str) else {str(key): value for key, value in status.items()}
            return json.loads(json.dumps(plain, default=str)), None
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a plugin's code, which may fail in any way
            return None, f"{type(error).__name__}: {error}"[:500]

    try:
        return run_sync(asyncio.wait_for(in_thread(ask), timeout_s))
    except TimeoutError:
        return None, f"it did not answer within {timeout_s:g} s"


def problems_of(
    plugins: Iterable[Plugin], timeout_s: float = TIMEOUT_S, *, quick: bool = False
) -> Iterator[tuple[Plugin, list[str]]]:
    """Yield each plugin with one line for each thing that is wrong with it, though it loads.

    Args:
        plugins: What is tried, each in an interpreter of its own, as many at once as there are processors.
        timeout_s: Seconds that the import of one entry point may take.
        quick: Whether to import nothing, and tell of conflicts only.
    """
    stop = threading.Event()

    def tried(plugin: Plugin) -> tuple[Plugin, list[str]]:
        if quick or plugin.failure is not None or plugin.disabled or plugin.is_core:
            return plugin, plugin.conflicts
        seen = imported(plugin.entry_point, timeout_s, stop)
        return plugin, [*plugin.conflicts, *([seen.failure] if seen.failure else seen.problems)]

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield from pool.map(tried, plugins)
        finally:  # after an interrupt, do not wait for the others
            stop.set()
            pool.shutdown(cancel_futures=True)


def _load_quietly() -> list[str]:
    """Load the plugins and return what was logged, except failures, which the report shows in full."""
    logger = logging.getLogger("gem_core.registry.plugins")
    notes: list[str] = []

    def keep(record: logging.LogRecord) -> bool:
        message = record.getMessage()
        if not message.endswith("for the whole."):  # those are in the report in full
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
    found = {extra: {name: installed_version(name) for name in names} for extra, names in extras_of("gem-core").items()}
    return [
        {"extra": extra, "packages": packages, "present": all(packages.values())} for extra, packages in found.items()
    ]


def which_gem() -> RequirementStatus:
    """Tell whether the command ``gem`` of this PATH is ours; RubyGems has one of that name."""
    path = shutil.which("gem")
    if path is None:
        return RequirementStatus(
            "unmet", "no 'gem' is on the PATH", "activate its environment, or use 'python -m gem_core'"
        )
    if Path(path).resolve().parent == Path(sys.executable).parent.resolve():
        return RequirementStatus("met", path)
    try:
        with open(path, "rb") as script:
            ours = b"gem_core" in script.read(4096)
    except OSError:
        ours = False
    if ours:
        return RequirementStatus("met", f"{path}, of another installation of GEM")
    return RequirementStatus(
        "unmet", f"{path} is another program called 'gem'", "use 'gem-core', or 'python -m gem_core'"
    )
