"""``Registry``: looks up environments by id, and wrappers, tools, backends and agents by name."""

from __future__ import annotations

import threading
from collections import defaultdict
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

from gem_core import errors
from gem_core.errors import GemError, RegistrationError, UnknownEnvError, UnknownNameError, UnknownPluginError
from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS
from gem_core.registry.plugins import Plugin, Record, complain, load_plugins
from gem_core.registry.specs import AgentSpec, EnvSpec, NamedSpec, ToolSpec, VectorBackendSpec
from gem_core.suggestions import did_you_mean

R = TypeVar("R", EnvSpec, NamedSpec, ToolSpec, VectorBackendSpec, AgentSpec)
N = TypeVar("N", bound=NamedSpec)

_WANTED: dict[type[Record], tuple[type[UnknownNameError], list[str]]] = {
    EnvSpec: (UnknownEnvError, ["environment"]),
    NamedSpec: (errors.UnknownWrapperError, ["wrapper", "tool"]),
    ToolSpec: (errors.UnknownToolError, ["tool"]),
    VectorBackendSpec: (errors.UnknownBackendError, ["vector backend"]),
    AgentSpec: (errors.UnknownAgentError, ["agent"]),
}
"""The error of an unknown name by the class that was looked for, and the kinds of record that would do."""


class Registry:
    """All records of one process; the first look-up loads the installed plugins."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._loaded = self._loading = False
        self._clear()

    def _clear(self) -> None:
        self._plugins: list[Plugin] = []
        self._spaces: defaultdict[str, dict[str, Any]] = defaultdict(dict)
        """Records by id or name, in spaces: ``"wrapper"`` holds the tools too, every other kind has its own."""
        self._providers: dict[str, Plugin] = {}
        self._contested: dict[tuple[str, str], str] = {}
        """Ids and names, by space, that several plugins offer, each with the message of the error."""

    # Looking up.

    def env(self, env_id: str) -> EnvSpec:
        """Return the spec of an environment.

        Raises:
            UnknownEnvError: No environment has this id; the message names the nearest, or the plugin to install.
            RegistrationError: Two plugins offer the id.
        """
        return self._find(EnvSpec, "env", env_id)

    def wrapper(self, name: str) -> NamedSpec:
        """Return the spec of a wrapper or tool."""
        return self._find(NamedSpec, "wrapper", name)

    def tool(self, name: str) -> ToolSpec:
        """Return the spec of a tool."""
        return self._find(ToolSpec, "wrapper", name)

    def backend(self, name: str) -> VectorBackendSpec:
        """Return the spec of a vector backend."""
        return self._find(VectorBackendSpec, "vector backend", name)

    def agent(self, name: str) -> AgentSpec:
        """Return the spec of an agent."""
        return self._find(AgentSpec, "agent", name)

    def _find(self, wanted: type[R], space: str, name: str) -> R:
        if not self._loaded:
            self.load()
        record = self._spaces[space].get(name) if isinstance(name, str) else None
        if isinstance(record, wanted):
            return record
        raise self._unknown(wanted, space, name)

    def env_of_folder(self, folder: Path) -> EnvSpec:
        """Return the spec of the environment that a folder belongs to; see ``EnvSpec.folder_markers``.

        Args:
            folder: A folder with one of the files, at most two levels deep.

        Raises:
            UnknownEnvError: The folder belongs to no environment, or to several.
        """
        markers = {record: record.folder_markers for record in self.envs() if record.folder_markers}
        for below in ("", "*/", "*/*/"):
            owners = [
                record for record, names in markers.items() if any(any(folder.glob(below + name)) for name in names)
            ]
            if len(owners) == 1:
                return owners[0]
            if owners:
                names = " and ".join(record.id for record in owners)
                raise UnknownEnvError(f"the folder {str(folder)!r} belongs to {names}; give the id of one of them")
        known = "; ".join(f"{record.id} looks for {' or '.join(names)}" for record, names in markers.items())
        raise UnknownEnvError(f"the folder {str(folder)!r} belongs to no environment: {known or 'none takes folders'}")

    def provider(self, env_id: str) -> Plugin | None:
        """Return the plugin that offers an environment; None for an environment that the program registered."""
        if not self._loaded:
            self.load()
        return self._providers.get(env_id)

    def envs(self, pattern: str | None = None) -> list[EnvSpec]:
        """Return the specs of environments in order of id.

        Args:
            pattern: A namespace, part of an id, or a glob such as ``game:*-easy``; None for all.
        """
        self.load()
        records: list[EnvSpec] = [record for _, record in sorted(self._spaces["env"].items())]
        if pattern is None:
            return records
        folded = pattern.casefold()
        in_namespace = [record for record in records if record.namespace.casefold() == folded.removesuffix(":")]
        glob = folded if any(character in folded for character in "*?[") else f"*{folded}*"
        return in_namespace or [record for record in records if fnmatchcase(record.id.casefold(), glob)]

    def specs(self, kind: type[N]) -> list[N]:
        """Return the specs of one kind, such as ``ToolSpec``, in order of name."""
        self.load()
        return [record for _, record in sorted(self._spaces[_space(kind.kind)].items()) if isinstance(record, kind)]

    def plugins(self) -> list[Plugin]:
        """Return the installed plugins, also the ones that failed."""
        self.load()
        return list(self._plugins)

    def plugins_named(self, name: str) -> list[Plugin]:
        """Return the plugins of a name, which is their entry point's or their distribution's."""
        found = [plugin for plugin in self.plugins() if name in (plugin.name, plugin.distribution)]
        if not found:
            names = [plugin.name for plugin in self.plugins()]
            raise UnknownPluginError(f"no plugin {name!r}.{did_you_mean(name, names)} Installed: {', '.join(names)}")
        return found

    # Adding records.

    def load(self) -> None:
        """Load the installed plugins, once.

        Raises:
            RegistrationError: A plugin uses the registry while it is being loaded; that fails this plugin alone.
            PluginError: A plugin failed and ``GEM_PLUGINS_STRICT`` is set.
        """
        if self._loaded:
            return
        with self._lock:
            if self._loaded:
                return
            if self._loading:
                raise RegistrationError("the registry was used while plugins are loaded; hooks return records alone")
            self._loading = True
            self._clear()
            try:
                self._plugins = load_plugins()
                self._take(self._plugins)
                self._loaded = True
            finally:
                self._loading = False

    def add(self, record: EnvSpec) -> None:
        """Add an environment that the program registers.

        Raises:
            RegistrationError: The id is taken. The same class may be registered again, as a notebook cell does.
        """
        self.raise_if_ambiguous("env", record.id)
        with self._lock:
            present, provider = self._spaces["env"].get(record.id), self._providers.get(record.id)
            if present is not None and (provider or _place(present) != _place(record)):
                owner = provider or "register()"
                raise RegistrationError(f"environment {record.id!r} is {owner}'s already; choose another id or version")
            self._spaces["env"][record.id] = record

    def _take(self, plugins: list[Plugin]) -> None:
        """Add the specs of plugins, the core's first; an id or name that several offer is none's, or the core's."""
        offers: defaultdict[tuple[str, str], list[tuple[Plugin, Record]]] = defaultdict(list)
        for plugin in plugins:
            for record in plugin.records:
                key = ("env", record.id) if isinstance(record, EnvSpec) else (_space(record.kind), record.name)
                offers[key].append((plugin, record))
        conflicts = []
        for (space, name), offered in offers.items():
            owner, record = offered[0]
            if len(offered) > 1 and space != "requirement":  # several plugins may need the same word
                kinds = " or ".join(sorted({getattr(record, "kind", "env") for _, record in offered}))
                owners = " and ".join(str(plugin) for plugin, _ in offered)
                conflicts.append(f"{kinds} {name!r} is offered by {owners}")
                for plugin in {plugin for plugin, _ in offered if not plugin.is_core}:
                    plugin.conflicts.append(conflicts[-1])
                if not owner.is_core:
                    self._contested[space, name] = conflicts[-1]
                    continue
            self._spaces[space][name] = record
            if space == "env":
                self._providers[name] = owner
        if conflicts:
            complain(conflicts[0] + (f" (and {len(conflicts) - 1} more)" if conflicts[1:] else ""))

    # Error messages.

    def raise_if_ambiguous(self, space: str, name: str) -> None:
        """Raise if several plugins offer an id or a name.

        Args:
            space: ``"env"``, ``"wrapper"`` (tools too), ``"vector backend"``, ``"agent"`` or ``"command"``.
            name: The id or name.

        Raises:
            RegistrationError: It names the plugins.
        """
        self.load()
        if message := self._contested.get((space, name)):
            raise RegistrationError(f"{message}; uninstall one of them, or disable it with GEM_PLUGINS_DISABLE")

    def install_hint(self, name: str, *kinds: str) -> str:
        """Return a sentence that names the plugin to install for a name, or the disabled plugin that has it.

        Args:
            name: Name of a record, or a namespace of environments.
            *kinds: Kinds of the record, or ``"namespace"``; any kind if none is given.

        Returns:
            It begins with a space; empty if no distribution of this project has the name, or if it is installed.
        """
        owners = [
            owner
            for owner, offered in KNOWN_DISTRIBUTIONS.items()
            if any(name in names.split() for kind, names in offered.items() if not kinds or kind in kinds)
        ]
        present = {plugin.distribution: plugin for plugin in self.plugins()}
        if missing := [owner for owner in owners if owner not in present]:
            return f" It comes with a plugin: try 'pip install {' '.join(missing)}'."
        disabled = [str(present[owner]) for owner in owners if present[owner].disabled]
        return f" It may belong to {', '.join(disabled)}, which GEM_PLUGINS_DISABLE skips." if disabled else ""

    def _unknown(self, wanted: type[Record], space: str, name: Any) -> GemError:
        """Return the error of an id or name: the plugin to install, the nearest names, the plugins that failed."""
        error, kinds = _WANTED[wanted]
        if not isinstance(name, str):
            return error(f"the name of a {' or '.join(kinds)} is a string, not {name!r}")
        self.raise_if_ambiguous(space, name)
        names = sorted(each for each, record in self._spaces[space].items() if isinstance(record, wanted))
        if wanted is EnvSpec:
            namespace = name.partition(":")[0]
            namespaces = sorted({each.partition(":")[0] for each in names})
            if ":" not in name:  # 'gem info' takes names of tools and the like as well
                names += [each for other, records in self._spaces.items() if other != "command" for each in records]
            hint = "" if namespace in namespaces else self.install_hint(namespace)
            hint = hint or did_you_mean(name, names)
            if not hint and namespace not in namespaces:
                known = f" Namespaces: {', '.join(namespaces) or 'none'}."
                hint = f"{known} What gem.register adds is known to its own process alone."
            advice = f" Run 'gem list{f' {namespace}' if namespace in namespaces else ''}'"
        else:
            hint = self.install_hint(name, *kinds) or did_you_mean(name, names)
            advice = f" There are: {', '.join(names)}." if names else ""
            if not hint and not names:
                hint = " None is installed: try 'pip install gem-tools'."
        failed = "; ".join(f"{plugin}: {plugin.failure.error}" for plugin in self._plugins if plugin.failure)
        cause = f" It may belong to a plugin that failed: {failed}." if failed else ""
        return error(f"no {' or '.join(kinds)} {name!r}.{hint}{cause}{advice}")


_registry = Registry()


def registry() -> Registry:
    """Return the registry of this process."""
    return _registry


def _place(record: EnvSpec) -> str:
    entry_point = record.entry_point
    if isinstance(entry_point, str):
        return entry_point
    return f"{entry_point.__module__}:{getattr(entry_point, '__qualname__', repr(entry_point))}"


def _space(kind: str) -> str:
    return "wrapper" if kind == "tool" else kind
