"""``check_plugin``: loads an installed plugin in another interpreter and tries what it declares."""

from __future__ import annotations

import sys
from collections.abc import Collection
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING, Any

from gem_core.arguments import check_arguments
from gem_core.errors import GemError, RegistrationError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.plugins import Record, one_line
from gem_core.registry.requirements import RequirementStatus, unmet
from gem_core.registry.specs import EnvSpec, RequirementSpec, ToolSpec
from gem_core.testing.elsewhere import Sender, run_elsewhere
from gem_core.testing.findings import Findings, place_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

TIMEOUT_S = 60.0
"""Default limit for the import of one entry point, in seconds."""


def check_plugin(plugin: str | ModuleType, *, allow: Collection[str] = ()) -> list[str]:
    """Try everything that an installed plugin promises: that it declares only, and that what it declares is there.

    Args:
        plugin: Name of its entry point or distribution, or its declaring module.
        allow: Packages of others that its declaring module may import.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownPluginError: No plugin of this name is installed.
    """
    if isinstance(plugin, ModuleType):
        named = {each.entry_point.module: each.name for each in registry().plugins()}
        plugin = named.get(plugin.__name__, plugin.__name__)
    point = registry().plugins_named(plugin)[0].entry_point
    seen = inspect_plugin(point)
    findings = Findings(f"plugin {point.name!r}")
    if not findings.expect("It loads, and its hooks return records.", seen.failure is None, seen.failure):
        findings.result()
    own = {point.module.partition(".")[0], *allow}
    foreign = sorted(set(seen.packages) - own)
    findings.expect(
        "Declaring imports the standard library, gem_core and the plugin's own package, and nothing else.",
        not foreign,
        f"it imports {', '.join(foreign)}; import these in the module of the implementation",
    )
    findings.expect("It writes nothing to standard output.", not seen.printed, seen.printed[:200])
    findings.expect("It offers something.", bool(seen.summaries), "no hook returned a record")
    mute = [name for name, summary in seen.summaries.items() if not summary.strip()]
    findings.expect("Every record has a summary.", not mute, f"without one: {', '.join(mute)}")
    wrong = seen.problems()
    findings.expect("Every entry point can be imported, and takes its arguments.", not wrong, "; ".join(wrong))
    return findings.result()


@dataclass
class Inspection:
    """What was found out about a plugin.

    Args:
        failure: Why it could not be loaded, or None.
        packages: Top-level packages that declaring imported, beside the standard library and the core.
        printed: What declaring and importing wrote to standard output.
        summaries: The summary of each record, by its name.
        errors: What is wrong with the entry points of a record, by its name; records that are fine are left out.
    """

    failure: str | None = "it was not tried"
    packages: list[str] = field(default_factory=list)
    printed: str = ""
    summaries: dict[str, str] = field(default_factory=dict)
    errors: dict[str, str] = field(default_factory=dict)

    def problems(self) -> list[str]:
        """Return one line for each error, with the records that have it."""
        names: dict[str, list[str]] = {}
        for name, error in self.errors.items():
            names.setdefault(error, []).append(name)
        return [
            f"{first}: {error}" + (f" (and {len(more)} more)" if more else "")
            for error, (first, *more) in names.items()
        ]


def inspect_plugin(point: EntryPoint, timeout_s: float = TIMEOUT_S) -> Inspection:
    """Load one plugin, without the others, and import every entry point that its records name.

    It is done in another interpreter. A module that ends or hangs it is named, and what comes after is not tried.

    Args:
        point: The plugin.
        timeout_s: Seconds that each import may take.
    """
    outcome = run_elsewhere(_import_all, point.name, timeout_s, variables=_others_disabled(point))
    seen = Inspection(printed=outcome.printed)
    present = ""
    for what, value in outcome.messages:
        if what == "loaded":
            seen.failure, seen.packages, seen.summaries = value
        elif what == "importing":
            present = value
        else:
            seen.errors[present] = value
    if outcome.problem and present:
        problem = f"while its entry point was imported, {outcome.problem}; what comes after it was not tried"
        seen.errors[present] = problem
    elif outcome.problem:
        seen.failure = f"while it was loaded, {outcome.problem}"
    return seen


def _others_disabled(point: EntryPoint) -> dict[str, str]:
    """Return the environment variables with which only one plugin is loaded, and its failure is not raised."""
    others = [plugin.name for plugin in registry().plugins() if plugin.name != point.name]
    return {"GEM_PLUGINS_DISABLE": ",".join(others), "GEM_PLUGINS_STRICT": ""}


# These functions run in the other interpreter.


def _import_all(send: Sender, name: str, timeout_s: float) -> None:
    """Load a plugin, send what it declares, and then each record that is imported and what is wrong with it."""
    import pluggy  # noqa: F401 - what the loader itself needs is no import of the plugin's

    send.allow(timeout_s)
    before = set(sys.modules)
    plugin = registry().plugins_named(name)[0]
    packages = {module.partition(".")[0] for module in set(sys.modules) - before}
    packages -= {*sys.stdlib_module_names, "gem_core", "pluggy"}
    failure = None if plugin.failure is None else plugin.failure.error
    summaries = {_name(record): record.summary for record in plugin.records}
    send("loaded", [failure, sorted(each for each in packages if not each.startswith("__editable__")), summaries])
    for record in plugin.records:
        send("importing", _name(record))
        send.allow(timeout_s)
        problem = _problem(record)
        if problem:
            send("wrong", problem)


def _name(record: Record) -> str:
    return record.id if isinstance(record, EnvSpec) else f"{record.kind} {record.name}"


def _problem(record: Record) -> str:
    """Return what is wrong with the entry points of a record, and where; ``""`` where nothing is."""
    package = _module(record).partition(".")[0]
    try:
        _check_entry_points(record)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code may raise anything
        cause = error.__cause__
        needs_another = isinstance(cause, ImportError) and (cause.name or "").partition(".")[0] != package
        if needs_another and isinstance(record, EnvSpec) and unmet(record.requires):
            return ""  # its module imports a requirement that is not installed
        place = "" if cause is None else place_of(cause, package)
        text = f"{error}" if isinstance(error, GemError) else one_line(error)
        return (f"{place}: " if place else "") + " ".join(text.split())
    return ""


def _check_entry_points(record: Record) -> None:
    """Import the entry points of a record, and raise an error if one has the wrong type."""
    target = load_entry_point(record.entry_point, "its entry point")
    if isinstance(record, ToolSpec) and record.status is not None:
        load_entry_point(record.status, "its status")
    if isinstance(record, EnvSpec):
        asked_for = {word.removeprefix("argument:"): None for word in record.requires if word.startswith("argument:")}
        given = {name: value for name, value in record.kwargs.items() if name != "render_mode"}
        check_arguments(target, (), asked_for | given, "its kwargs")
    if isinstance(record, RequirementSpec):
        check_arguments(target, ("",), {"closely": False}, "its probe")
        answer = target("", closely=False)
        if not isinstance(answer, RequirementStatus):
            raise RegistrationError(f"{record.entry_point!r} returned {answer!r:.100}, and no RequirementStatus")
    if record.instance_of is not None:
        base: Any = load_entry_point(record.instance_of, "its kind")
        if not isinstance(target, base):
            raise RegistrationError(
                f"{record.entry_point!r} is a {type(target).__name__}, and no {_expected_type(base)}"
            )
    if record.subclass_of is not None and isinstance(target, type):
        base = load_entry_point(record.subclass_of, "its kind")
        if not issubclass(target, base):
            raise RegistrationError(f"{record.entry_point!r} does not derive from {_expected_type(base)}")


def _expected_type(base: type) -> str:
    return f"{base.__module__.partition('.')[0]}.{base.__name__}"


def _module(record: Record) -> str:
    point = record.entry_point
    module = point if isinstance(point, str) else str(getattr(point, "__module__", ""))
    return module.partition(":")[0]
