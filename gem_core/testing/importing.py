"""Import the entry points of an installed plugin in other interpreters, which may die or hang."""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import IO, Any

from gem_core.arguments import check_arguments
from gem_core.errors import GemError, RegistrationError
from gem_core.failures import shown_place
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.hookspecs import ENTRY_POINT_GROUP
from gem_core.registry.plugins import Record, one_line
from gem_core.registry.requirements import RequirementStatus, unmet
from gem_core.registry.specs import EnvSpec, RequirementSpec, ToolSpec
from gem_core.testing.findings import place_of
from gem_core.testing.interpreter import CallError, ProcessLostError, Sender, sent_by

TIMEOUT_S = 60.0
"""Default limit for the import of one entry point, in seconds."""


@dataclass
class Imported:
    """What was found out about a plugin.

    Args:
        failure: Why it could not be loaded, or None.
        packages: Top-level packages that declaring imported, beside the standard library and the core.
        printed: What declaring and importing wrote to standard output.
        records: Of each record the ``name``, the ``module`` of its entry point, the ``summary``, and the ``error``:
            empty where its entry point can be used, None if that has not been tried.
    """

    failure: str | None = None
    packages: list[str] = field(default_factory=list)
    printed: str = ""
    records: list[dict[str, Any]] = field(default_factory=list)

    @property
    def problems(self) -> list[str]:
        """One line for each error, with the records that have it."""
        names: dict[str, list[str]] = {}
        for record in self.records:
            if record["error"]:
                names.setdefault(record["error"], []).append(record["name"])
        return [
            f"{first}: {error}" + (f" (and {len(more)} more)" if more else "")
            for error, (first, *more) in names.items()
        ]


def imported(point: EntryPoint, timeout_s: float = TIMEOUT_S, stopped: Callable[[], bool] = lambda: False) -> Imported:
    """Load one plugin, without the others, and import every entry point that its records name.

    A module that ends or hangs its interpreter is named, and the others are tried in another.

    Args:
        point: The plugin.
        timeout_s: Seconds that each import may take.
        stopped: Ends the imports once it returns True.
    """
    seen: Imported | None = None
    untried = [0]
    while untried and not stopped():
        # Files and not pipes: what the interpreter starts may outlive it.
        with tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as complained:
            files: dict[str, Any] = {"stdout": printed, "stderr": complained, "stopped": stopped}
            args = (point.name, _distribution(point), timeout_s, untried if seen else None)
            try:
                with closing(sent_by(_import_all, *args, variables=_others_disabled(point), **files)) as answers:
                    loaded = next(answers)
                    seen = seen or Imported(**loaded)
                    for number, error in answers:
                        seen.records[number]["error"] = error
            except CallError as error:
                how = _how_it_ended(error, _text(complained))
                if seen is None:
                    return Imported(f"while it was loaded, {how}", printed=_text(printed))
                untried = [number for number, record in enumerate(seen.records) if record["error"] is None]
                module = seen.records[untried[0]]["module"]
                place = _place_in(module, _text(complained))
                for record in seen.records:  # the other records of that module fail the same way
                    if record["module"] == module and record["error"] is None:
                        record["error"] = f"{place}while its entry point was imported, {how}"
            seen.printed += _text(printed)
        untried = [number for number, record in enumerate(seen.records) if record["error"] is None]
    return seen or Imported("it was not tried")


def _others_disabled(point: EntryPoint) -> dict[str, str]:
    """Return the environment variables with which only one plugin is loaded, and its failure is not raised."""
    others = [other for other in entry_points(group=ENTRY_POINT_GROUP) if other != point]
    names = {name for other in others for name in (other.name, _distribution(other))}
    disabled = sorted(names - {point.name, _distribution(point)})
    return {"GEM_PLUGINS_DISABLE": ",".join(disabled), "GEM_PLUGINS_STRICT": ""}


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else ""


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


def _how_it_ended(error: CallError, complaint: str) -> str:
    """Return how an import ended that did not return, with the last line of standard error."""
    if not isinstance(error, ProcessLostError):
        return str(error)
    if error.exit_code is None:
        return "it took too long"
    lines = complaint.strip().splitlines()
    last = next((line for line in lines if line.startswith("Fatal Python error: ")), lines[-1] if lines else "")
    return f"the interpreter ended with exit code {error.exit_code}" + (f": {last[:200]}" if last else "")


def _place_in(module: str, complaint: str) -> str:
    """Return file and line of a module's package that was running when the interpreter was ended or crashed."""
    package = re.escape(module.partition(".")[0])
    stood = re.search(rf'File "(.*/{package}(?:/.*|\.py))", line (\d+) in ', complaint)
    return f"{shown_place(stood[1], int(stood[2]))}: " if stood else ""


# These functions run in the other interpreter.


def _import_all(send: Sender, name: str, distribution: str, timeout_s: float, numbers: Sequence[int] | None) -> None:
    """Load a plugin, send the fields of ``Imported``, and for each record its number and what is wrong with it."""
    import pluggy  # noqa: F401 - what the loader itself needs is no import of the plugin's

    from gem_core.registry.lookup import registry

    send.allow(timeout_s)
    before = set(sys.modules)
    plugins = [each for each in registry().plugins() if each.name == name]
    plugin = next(each for each in plugins if distribution in ("", each.distribution))
    packages = {name.partition(".")[0] for name in set(sys.modules) - before}
    packages -= {*sys.stdlib_module_names, "gem_core", "pluggy"}
    records = [
        {
            "name": record.id if isinstance(record, EnvSpec) else f"{record.kind} {record.name}",
            "module": _module(record),
            "summary": record.summary,
            "error": None,
        }
        for record in plugin.records
    ]
    send(
        {
            "failure": None if plugin.failure is None else plugin.failure.error,
            "packages": sorted(name for name in packages if not name.startswith("__editable__")),
            "records": records,
        }
    )
    for number in range(len(records)) if numbers is None else numbers:
        send.allow(timeout_s)
        send((number, _problem(plugin.records[number])))


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
