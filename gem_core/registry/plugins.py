"""The plugin loader: every installed plugin is found, loaded and asked, and a broken one breaks nothing else.

pluggy's own ``load_setuptools_entrypoints`` stops at the first plugin that fails, and ignores a hook with a misspelt
name. Here each plugin is loaded and called behind its own guard, and its records are taken all or none.
"""

from __future__ import annotations

import inspect
import logging
import os
import reprlib
import time
import traceback
import typing
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, distributions
from typing import Any

import pluggy

from gem_core.errors import PluginError, RegistrationError
from gem_core.failures import shown_error
from gem_core.registry import hookspecs
from gem_core.registry.specs import EnvSpec, NamedSpec
from gem_core.suggestions import did_you_mean

logger = logging.getLogger(__name__)

BUILTIN = "gem_core._plugin"
"""Module of the core's own records, which use the same hooks as plugins."""

RECORD_TYPES: dict[str, type[EnvSpec | NamedSpec]] = {
    name: typing.get_args(typing.get_type_hints(hook)["return"])[0]
    for name, hook in vars(hookspecs).items()
    if name.startswith("gem_")
}
"""The class that each hook returns, read from its specification: a new kind of record is a class and a hook."""

Record = EnvSpec | NamedSpec


@dataclass(frozen=True)
class PluginFailure:
    """An error of a plugin.

    Args:
        stage: Stage of loading that failed: ``"load"``, ``"hooks"`` or ``"call"``.
        error: The error in one line.
        traceback: The whole traceback.
    """

    stage: str
    error: str
    traceback: str


@dataclass(eq=False)
class Plugin:
    """One entry point of the group ``gem.plugins``, and the result of loading it.

    Args:
        entry_point: Its entry point.
        distribution: Name of the installed distribution.
        version: Its version.
        load_time_s: Seconds from the start of the import to the last record.
        records: The records that it offers; empty after a failure.
        failure: The failure, if it offers nothing for one.
        disabled: Whether ``GEM_PLUGINS_DISABLE`` names it.
        conflicts: One line for each id or name that is offered by another plugin too, or twice.
    """

    entry_point: EntryPoint
    distribution: str
    version: str
    load_time_s: float = 0.0
    records: list[Record] = field(default_factory=list)
    failure: PluginFailure | None = None
    disabled: bool = False
    conflicts: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The name of its entry point."""
        return self.entry_point.name

    @property
    def is_core(self) -> bool:
        """Whether this is the core's own plugin."""
        return self.entry_point.value == BUILTIN

    def __str__(self) -> str:
        return f"plugin {self.name!r} ({self.distribution} {self.version})"


def load_plugins() -> list[Plugin]:
    """Load every installed plugin, the core's own records first, the others by name.

    Environment variables: ``GEM_PLUGINS_DISABLE=a,b`` skips plugins by their name or their distribution's;
    ``GEM_PLUGINS_STRICT=1`` raises at the first failure.

    Raises:
        PluginError: A plugin failed and ``GEM_PLUGINS_STRICT`` is set.
    """
    from gem_core import __version__

    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    core = Plugin(EntryPoint("core", BUILTIN, hookspecs.ENTRY_POINT_GROUP), "gem-core", __version__)
    found = sorted(find_plugins(), key=lambda plugin: (plugin.name, plugin.entry_point.value))
    disabled = {name.strip() for name in os.environ.get("GEM_PLUGINS_DISABLE", "").split(",") if name.strip()}
    for plugin in found:
        plugin.disabled = not disabled.isdisjoint((plugin.name, plugin.distribution))
    for plugin in (core, *found):
        if not plugin.disabled:
            _load(plugin, manager)
    return [core, *found]


def find_plugins() -> list[Plugin]:
    """Return the installed plugins, not yet loaded; a distribution that cannot be read is named in a warning."""
    found: dict[tuple[str, str, str], Plugin] = {}  # an editable install can show one plugin twice on one path
    for distribution in distributions():
        try:
            for point in distribution.entry_points.select(group=hookspecs.ENTRY_POINT_GROUP):
                plugin = Plugin(point, distribution.name or "unnamed", distribution.version or "?")
                found.setdefault((plugin.name, point.value, plugin.distribution), plugin)
        except Exception as error:  # noqa: BLE001 - garbage in one distribution must not hide the others
            where = getattr(distribution, "_path", "an unnamed distribution")
            logger.warning("gem: the entry points of %s cannot be read (%s).", where, one_line(error))
    return list(found.values())


def _load(plugin: Plugin, manager: pluggy.PluginManager) -> None:
    """Import a plugin and take its records, all or none; a failure is kept as data."""
    started = time.perf_counter()
    stage = "load"
    try:
        module: Any = plugin.entry_point.load()
        stage = "hooks"
        _check_hooks(module)
        manager.register(module, name=f"{plugin.distribution}:{plugin.name}")  # it checks the hooks' arguments
        stage = "call"
        # The call is ours: pluggy's would drop a None without a word, and lose everyone's records when one hook raises.
        plugin.records = [
            record
            for hook, record_type in RECORD_TYPES.items()
            if hasattr(module, hook)
            for record in _checked(hook, record_type, getattr(module, hook)())
        ]
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a plugin does must not break the others
        plugin.failure = PluginFailure(stage, one_line(error), traceback.format_exc())
        complain(f"{plugin} failed at stage '{stage}': {plugin.failure.error}", error)
    finally:
        plugin.load_time_s = time.perf_counter() - started


def _check_hooks(module: Any) -> None:
    """Reject what pluggy would silently ignore: unknown hook names, and hooks that lack their mark."""
    for name, function in inspect.getmembers(module, inspect.isroutine):
        is_marked = hasattr(function, f"{hookspecs.PROJECT}_impl")
        if not is_marked and not name.startswith(("gem_register_", "gem_add_")):
            continue
        if name not in RECORD_TYPES:
            raise RegistrationError(f"no hook is called {name!r}.{did_you_mean(name, RECORD_TYPES)}")
        if not is_marked:
            raise RegistrationError(f"{name!r} is not marked; put '@gem_core.hookimpl' above it")


def _checked(hook: str, record_type: type[Record], offered: Any) -> list[Record]:
    is_list = isinstance(offered, Iterable) and not isinstance(offered, str | bytes)
    records = list(offered) if is_list else [offered]
    for record in records:
        if not (is_list and isinstance(record, record_type)):
            raise RegistrationError(f"{hook} must return {record_type.__name__} records, not {reprlib.repr(record)}")
    return records


def complain(line: str, cause: BaseException | None = None) -> None:
    """Log in one line what is wrong with a plugin, or raise if ``GEM_PLUGINS_STRICT`` is set.

    Raises:
        PluginError: ``GEM_PLUGINS_STRICT`` is set.
    """
    if os.environ.get("GEM_PLUGINS_STRICT", "") not in ("", "0"):
        raise PluginError(f"{line} (GEM_PLUGINS_STRICT is set)") from cause
    logger.warning("gem: %s. Everything else works; run 'gem plugins --check' for the whole.", line)


def one_line(error: BaseException) -> str:
    """Return the type and the message of an error in one line of bounded length."""
    return f"{' '.join(shown_error(error).split()):.500}"
