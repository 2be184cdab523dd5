"""``Registry``: looks up environments by id, and wrappers, tools, backends and agents by name."""

from __future__ import annotations

import threading
from collections.abc import Sequence
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
from gem_core.suggestions import did_you_mean, did_you_mean_one_of

N = TypeVar("N", bound=NamedSpec)

Key = tuple[str, str]
"""A space of names, and a name in it: ``("env", "game:Mastermind-v0")``."""


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
        # One space of names each for wrappers together with tools, and for every other kind.
        self._named: dict[str, dict[str, NamedSpec]] = {}
        self._providers: dict[str, Plugin] = {}
        # Ids and names that several plugins claim, each with the message of the error.
        self._ambiguous: dict[Key, str] = {}

    # Looking up.

    def env(self, env_id: str) -> EnvSpec:
        """Return the spec of an environment.

        Raises:
            UnknownEnvError: No environment has this id; the message names the nearest, or the plugin to install.
            RegistrationError: Two plugins claim the id.
        """
        if not isinstance(env_id, str):
            raise UnknownEnvError(f"an environment id is a string such as 'game:Mastermind-v0', not {env_id!r}")
        self.raise_if_ambiguous("env", env_id)
        record = self._envs.get(env_id)
        if record is None:
            raise UnknownEnvError(self._unknown_env(env_id))
        return record

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
        return self._find("wrapper", name, UnknownWrapperError)

    def tool(self, name: str) -> ToolSpec:
        """Return the spec of a tool."""
        self.raise_if_ambiguous("wrapper", name)
        record = self._named.get("wrapper", {}).get(name)
        if not isinstance(record, ToolSpec):
            names = [tool.name for tool in self.specs(ToolSpec)]
            hint = self.install_hint(name, "tool") or did_you_mean(name, names)
            if names:
                hint += f" There are: {', '.join(names)}."
            elif not hint:
                hint = " None is installed: try 'pip install gem-tools'."
            raise UnknownToolError(f"no tool {name!r}.{hint}{self._failed_plugins()}")
        return record

    def backend(self, name: str) -> VectorBackendSpec:
        """Return the spec of a vector backend."""
        return self._find("vector backend", name, UnknownBackendError)  # type: ignore[return-value]

    def agent(self, name: str) -> AgentSpec:
        """Return the spec of an agent."""
        return self._find("agent", name, UnknownAgentError)  # type: ignore[return-value]

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
        folded = pattern.casefold().removesuffix(":")
        in_namespace = [record for record in records if record.namespace.casefold() == folded]
        return in_namespace or [record for record in records if _matches(pattern, record.id)]

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
        """Raise if several plugins claim an id or a name.

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
        self.load()
        with self._lock:
            self.raise_if_ambiguous("env", record.id)
            present, provider = self._envs.get(record.id), self._providers.get(record.id)
            if present is not None and (provider is not None or not _same_entry_point(present, record)):
                raise RegistrationError(
                    f"environment {record.id!r} is registered already, by {provider or 'register()'}; "
                    "choose another id or version"
                )
            self._envs[record.id] = record

    def _take(self, plugins: list[Plugin]) -> None:
        """Add the specs of plugins, the core's first; an id or name that several claim is ambiguous."""
        claims: dict[Key, list[tuple[Plugin, Record | None]]] = {}
        for plugin in plugins:
            if not plugin.disabled:
                claims.setdefault(("plugin name", plugin.name), []).append((plugin, None))
            for offered in plugin.records:
                if isinstance(offered, RequirementSpec):  # several may need the same word; the first is asked
                    self._named.setdefault(offered.kind, {}).setdefault(offered.name, offered)
                    continue
                claims.setdefault(_key(offered), []).append((plugin, offered))
        disputes: dict[tuple[Plugin, ...], list[str]] = {}
        for key, claimants in claims.items():
            owner, record = claimants[0]
            if len(claimants) > 1:
                parties = tuple(dict.fromkeys(plugin for plugin, _ in claimants))
                kinds = sorted({each.kind for _, each in claimants if isinstance(each, NamedSpec)})
                what = f"{' or '.join(kinds) or key[0]} {key[1]!r}"
                disputes.setdefault(parties, []).append(self._dispute(key, what, parties))
            if record is not None and key not in self._ambiguous:
                self._store(record, owner)
        for messages in disputes.values():
            complain(messages[0] + (f" (and {len(messages) - 1} more)" if len(messages) > 1 else ""))

    def _dispute(self, key: Key, what: str, parties: Sequence[Plugin]) -> str:
        """Record that several plugins claim an id or a name, and warn; a name of the core stays with the core."""
        owner, *others = map(str, parties)
        if parties[0].is_core:
            message = f"{what} is the core's own, and is offered by {' and '.join(others)} too"
        elif others:
            message = f"{what} is offered by both {' and '.join([owner, *others])}"
        else:
            message = f"{what} is offered twice by {owner}"
        if not parties[0].is_core:
            self._ambiguous[key] = message
        for plugin in parties:
            if not plugin.is_core:
                plugin.conflicts.append(message)
        return message

    def _store(self, record: Record, owner: Plugin) -> None:
        if isinstance(record, EnvSpec):
            self._envs[record.id] = record
            self._providers[record.id] = owner
        else:
            self._named.setdefault(_space(record.kind), {})[record.name] = record

    # Error messages.

    def install_hint(self, name: str, kind: str | None = None) -> str:
        """Return a sentence that names the plugin to install for a name, or the disabled plugin that has it.

        Args:
            name: Name of a record, or a namespace of environments.
            kind: Kind of the record, or ``"namespace"``; None for any.

        Returns:
            It begins with a space; empty if no distribution of this project has the name, or if it is installed.
        """
        owners = distributions_with(name, kind)
        present = {plugin.distribution: plugin for plugin in self.plugins()}
        missing = [owner for owner in owners if owner not in present]
        if missing:
            return f" It comes with a plugin: try 'pip install {' '.join(missing)}'."
        disabled = [str(present[owner]) for owner in owners if present[owner].disabled]
        return f" It may belong to {', '.join(disabled)}, which GEM_PLUGINS_DISABLE skips." if disabled else ""

    def _find(self, space: str, name: str, error: type[UnknownNameError]) -> NamedSpec:
        self.raise_if_ambiguous(space, name)
        records = self._named.get(space, {})
        if name in records:
            return records[name]
        what = "wrapper or tool" if space == "wrapper" else space
        hint = self.install_hint(name, "tool" if space == "wrapper" else space) or did_you_mean(name, records)
        raise error(f"no {what} {name!r}.{hint} There are: {', '.join(sorted(records))}.{self._failed_plugins()}")

    def _unknown_env(self, env_id: str) -> str:
        namespace, colon, _ = env_id.partition(":")
        namespaces = sorted({record.namespace for record in self._envs.values()})
        failed = self._failed_plugins()
        if colon and namespace not in namespaces:
            advice = self.install_hint(namespace)
            if not advice and not failed:
                near = did_you_mean(env_id, self._envs) or did_you_mean(namespace, namespaces)
                known = f" Namespaces: {', '.join(namespaces) or 'none'}."
                advice = near or f"{known} What gem.register adds is known to its own process alone."
            return f"no environment {env_id!r}.{advice}{failed} Run 'gem list'"
        candidates = [name for name in self._envs if not colon or name.startswith(f"{namespace}:")]
        hint = "" if colon else self.install_hint(env_id)  # 'gem info' takes the names of all kinds
        hint = hint or did_you_mean(env_id, candidates) or did_you_mean(env_id, self._envs)
        if not hint:
            variants = sorted(name for name in self._envs if name.startswith(env_id))[:3] if env_id else []
            hint = did_you_mean_one_of(variants)
        if not hint and not colon:
            kinds = (ToolSpec, WrapperSpec, AgentSpec, VectorBackendSpec)
            hints = ((kind.kind, did_you_mean(env_id, (each.name for each in self.specs(kind)))) for kind in kinds)
            hint = next((text.replace("mean", f"mean the {kind}", 1) for kind, text in hints if text), "")
        return f"no environment {env_id!r}.{hint}{failed} Run 'gem list{f' {namespace}' if colon else ''}'"

    def _failed_plugins(self) -> str:
        failed = [plugin for plugin in self._plugins if plugin.failure is not None]
        causes = "; ".join(f"{plugin}: {plugin.failure.error}" for plugin in failed if plugin.failure)
        return f" It may belong to a plugin that failed: {causes}." if failed else ""


_registry = Registry()


def registry() -> Registry:
    """Return the registry of this process."""
    return _registry


def _key(record: Record) -> Key:
    return ("env", record.id) if isinstance(record, EnvSpec) else (_space(record.kind), record.name)


def _space(kind: str) -> str:
    return "wrapper" if kind == "tool" else kind


def _matches(pattern: str, env_id: str) -> bool:
    pattern, folded = pattern.casefold(), env_id.casefold()
    if any(character in pattern for character in "*?["):
        return fnmatchcase(folded, pattern)
    return pattern in folded


def _same_entry_point(first: EnvSpec, second: EnvSpec) -> bool:
    def name(entry_point: EntryPoint) -> object:
        if isinstance(entry_point, str):
            return entry_point
        qualified = getattr(entry_point, "__qualname__", "<lambda>")
        # Two functions without a name are two functions.
        return entry_point if "<lambda>" in qualified else (getattr(entry_point, "__module__", None), qualified)

    return name(first.entry_point) == name(second.entry_point)
