"""``Registry``: looks up environments by id, and wrappers, tools, backends and agents by name."""

from __future__ import annotations

import threading
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

from gem_core.errors import (
    RegistrationError,
    UnknownAgentError,
    UnknownBackendError,
    UnknownEnvError,
    UnknownNameError,
    UnknownPluginError,
    UnknownToolError,
    UnknownWrapperError,
)
from gem_core.registry.known_distributions import distributions_with
from gem_core.registry.plugins import Plugin, Record, complain, load_plugins
from gem_core.registry.specs import (
    AgentSpec,
    EntryPoint,
    EnvSpec,
    NamedSpec,
    RequirementSpec,
    ToolSpec,
    VectorBackendSpec,
    WrapperSpec,
)
from gem_core.suggestions import did_you_mean

N = TypeVar("N", bound=NamedSpec)

_UNKNOWN: dict[type[NamedSpec], type[UnknownNameError]] = {
    ToolSpec: UnknownToolError,
    WrapperSpec: UnknownWrapperError,
    VectorBackendSpec: UnknownBackendError,
    AgentSpec: UnknownAgentError,
}


class Registry:
    """All records of one process; the first look-up loads the installed plugins."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._loaded = False
        self._loading = False
        self._clear()

    def _clear(self) -> None:
        self._plugins: list[Plugin] = []
        self._envs: dict[str, EnvSpec] = {}
        self._named: dict[str, dict[str, NamedSpec]] = {}
        """Records by space of names: one for wrappers together with tools, and one for every other kind."""
        self._providers: dict[str, Plugin] = {}
        self._ambiguous: dict[tuple[str, str], str] = {}
        """Ids and names, by space, that several plugins offer, each with the message of the error."""

    # Looking up.

    def env(self, env_id: str) -> EnvSpec:
        """Return the spec of an environment.

        Raises:
            UnknownEnvError: No environment has this id; the message names the nearest, or the plugin to install.
            RegistrationError: Two plugins offer the id.
        """
        if not isinstance(env_id, str):
            raise UnknownEnvError(f"an environment id is a string such as 'game:Mastermind-v0', not {env_id!r}")
        self.load()
        if env_id not in self._envs:
            self.raise_if_ambiguous("env", env_id)
            raise UnknownEnvError(self._unknown_env(env_id))
        return self._envs[env_id]

    def env_of_folder(self, folder: Path) -> EnvSpec:
        """Return the spec of the environment that a folder belongs to; see ``EnvSpec.folder_markers``.

        Args:
            folder: A folder with one of the files, at most two levels deep.

        Raises:
            UnknownEnvError: The folder belongs to no environment, or to several.
        """
        takers = [record for record in self.envs() if record.folder_markers]
        for below in ("", "*/", "*/*/"):
            owners = [
                record
                for record in takers
                if any(any(folder.glob(f"{below}{marker}")) for marker in record.folder_markers)
            ]
            if len(owners) > 1:
                names = " and ".join(record.id for record in owners)
                raise UnknownEnvError(f"the folder {str(folder)!r} belongs to {names}; give the id of one of them")
            if owners:
                return owners[0]
        known = "; ".join(f"{record.id} looks for {' or '.join(record.folder_markers)}" for record in takers)
        raise UnknownEnvError(
            f"the folder {str(folder)!r} belongs to no environment: {known or 'none that is installed takes folders'}"
        )

    def wrapper(self, name: str) -> NamedSpec:
        """Return the spec of a wrapper or tool."""
        return self._find(NamedSpec, WrapperSpec, name)

    def tool(self, name: str) -> ToolSpec:
        """Return the spec of a tool."""
        return self._find(ToolSpec, ToolSpec, name)

    def backend(self, name: str) -> VectorBackendSpec:
        """Return the spec of a vector backend."""
        return self._find(VectorBackendSpec, VectorBackendSpec, name)

    def agent(self, name: str) -> AgentSpec:
        """Return the spec of an agent."""
        return self._find(AgentSpec, AgentSpec, name)

    def provider(self, env_id: str) -> Plugin | None:
        """Return the plugin that offers an environment; None for an environment that the program registered."""
        self.load()
        return self._providers.get(env_id)

    def plugins_named(self, name: str) -> list[Plugin]:
        """Return the plugins of a name, which is their entry point's or their distribution's."""
        found = [plugin for plugin in self.plugins() if name in (plugin.name, plugin.distribution)]
        if found:
            return found
        names = [plugin.name for plugin in self.plugins()]
        raise UnknownPluginError(
            f"no plugin {name!r}.{did_you_mean(name, names)} Installed: {', '.join(names)}. Run 'gem plugins'"
        )

    def envs(self, pattern: str | None = None) -> list[EnvSpec]:
        """Return the specs of environments in order of id.

        Args:
            pattern: A namespace, part of an id, or a glob such as ``game:*-easy``; None for all.
        """
        self.load()
        records = [self._envs[env_id] for env_id in sorted(self._envs)]
        if pattern is None:
            return records
        folded = pattern.casefold()
        in_namespace = [record for record in records if record.namespace.casefold() == folded.removesuffix(":")]
        glob = folded if any(character in folded for character in "*?[") else f"*{folded}*"
        return in_namespace or [record for record in records if fnmatchcase(record.id.casefold(), glob)]

    def specs(self, kind: type[N]) -> list[N]:
        """Return the specs of one kind, such as ``ToolSpec``, in order of name."""
        self.load()
        records = self._named.get(_space(kind.kind), {})
        return [record for name in sorted(records) if isinstance(record := records[name], kind)]

    def plugins(self) -> list[Plugin]:
        """Return the installed plugins, also the ones that failed."""
        self.load()
        return list(self._plugins)

    def raise_if_ambiguous(self, space: str, name: str) -> None:
        """Raise if several plugins offer an id or a name.

        Args:
            space: ``"env"``, ``"wrapper"`` (tools too), ``"vector backend"``, ``"agent"`` or ``"command"``.
            name: The id or name.

        Raises:
            RegistrationError: It names the plugins.
        """
        self.load()
        message = self._ambiguous.get((space, name))
        if message:
            raise RegistrationError(f"{message}; uninstall one of them, or disable it with GEM_PLUGINS_DISABLE")

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
                raise RegistrationError(
                    "the registry was used while plugins are being loaded; "
                    "a plugin returns its records from hooks and does nothing else"
                )
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
            present, provider = self._envs.get(record.id), self._providers.get(record.id)
            if present is not None and (provider or _place(present.entry_point) != _place(record.entry_point)):
                raise RegistrationError(
                    f"environment {record.id!r} is registered already, by {provider or 'register()'}; "
                    "choose another id or version"
                )
            self._envs[record.id] = record

    def _take(self, plugins: list[Plugin]) -> None:
        """Add the specs of plugins, the core's first; an id or name that several offer is none's, or the core's."""
        offers: dict[tuple[str, str], list[tuple[Plugin, Record]]] = {}
        for plugin in plugins:
            for record in plugin.records:
                key = ("env", record.id) if isinstance(record, EnvSpec) else (_space(record.kind), record.name)
                offers.setdefault(key, []).append((plugin, record))
        for (space, name), offered in offers.items():
            owner, record = offered[0]
            if len(offered) > 1 and not isinstance(record, RequirementSpec):  # several may need the same word
                kinds = sorted({getattr(record, "kind", "env") for _, record in offered})
                owners = " and ".join(str(plugin) for plugin, _ in offered)
                message = f"{' or '.join(kinds)} {name!r} is offered by {owners}"
                for plugin in dict.fromkeys(plugin for plugin, _ in offered if not plugin.is_core):
                    plugin.conflicts.append(message)
                if not owner.is_core:
                    self._ambiguous[space, name] = message
                    continue
            if isinstance(record, EnvSpec):
                self._envs[name], self._providers[name] = record, owner
            else:
                self._named.setdefault(space, {})[name] = record
        told: set[str] = set()
        for plugin in plugins:
            new = [message for message in plugin.conflicts if message not in told]
            told.update(new)
            if new:
                complain(new[0] + (f" (and {len(new) - 1} more)" if new[1:] else ""))

    # Error messages.

    def install_hint(self, name: str, *kinds: str) -> str:
        """Return a sentence that names the plugin to install for a name, or the disabled plugin that has it.

        Args:
            name: Name of a record, or a namespace of environments.
            *kinds: Kinds of the record, or ``"namespace"``; any kind if none is given.

        Returns:
            It begins with a space; empty if no distribution of this project has the name, or if it is installed.
        """
        owners = distributions_with(name, *kinds)
        present = {plugin.distribution: plugin for plugin in self.plugins()}
        missing = [owner for owner in owners if owner not in present]
        if missing:
            return f" It comes with a plugin: try 'pip install {' '.join(missing)}'."
        disabled = [str(present[owner]) for owner in owners if present[owner].disabled]
        return f" It may belong to {', '.join(disabled)}, which GEM_PLUGINS_DISABLE skips." if disabled else ""

    def _find(self, wanted: type[N], kind: type[NamedSpec], name: str) -> N:
        """Return the record of a name in the space of a kind, if it is of the class that is wanted."""
        space = _space(kind.kind)
        self.load()
        record = self._named.get(space, {}).get(name)
        if isinstance(record, wanted):
            return record
        self.raise_if_ambiguous(space, name)
        records = [each for each, other in self._named.get(space, {}).items() if isinstance(other, wanted)]
        kinds = ["wrapper", "tool"] if kind is WrapperSpec else [kind.kind]
        hint = self.install_hint(name, *kinds) or did_you_mean(name, records)
        if records:
            hint += f" There are: {', '.join(sorted(records))}."
        elif not hint:
            hint = " None is installed: try 'pip install gem-tools'."
        raise _UNKNOWN[kind](f"no {' or '.join(kinds)} {name!r}.{hint}{self._failed_plugins()}")

    def _unknown_env(self, env_id: str) -> str:
        """Return the message for an id, or for a name without a colon, as 'gem info' takes it."""
        namespace, colon, _ = env_id.partition(":")
        namespaces = sorted({record.namespace for record in self._envs.values()})
        is_known = namespace in namespaces
        others = [name for space, records in self._named.items() if space != "command" for name in records]
        failed = self._failed_plugins()
        hint = "" if colon and is_known else self.install_hint(namespace)
        if not hint and (is_known or not failed):
            own = [each for each in self._envs if each.startswith(f"{namespace}:")]
            hint = did_you_mean(env_id, own) or did_you_mean(env_id, [*self._envs, *([] if colon else others)])
        if not hint and colon and not is_known and not failed:
            known = f" Namespaces: {', '.join(namespaces) or 'none'}."
            hint = did_you_mean(namespace, namespaces) or (
                f"{known} What gem.register adds is known to its own process alone."
            )
        return f"no environment {env_id!r}.{hint}{failed} Run 'gem list{f' {namespace}' if is_known else ''}'"

    def _failed_plugins(self) -> str:
        causes = "; ".join(f"{plugin}: {plugin.failure.error}" for plugin in self._plugins if plugin.failure)
        return f" It may belong to a plugin that failed: {causes}." if causes else ""


_registry = Registry()


def registry() -> Registry:
    """Return the registry of this process."""
    return _registry


def _place(entry_point: EntryPoint) -> str:
    if isinstance(entry_point, str):
        return entry_point
    return f"{entry_point.__module__}:{getattr(entry_point, '__qualname__', repr(entry_point))}"


def _space(kind: str) -> str:
    return "wrapper" if kind == "tool" else kind
