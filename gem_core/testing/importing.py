"""Imports what an installed plugin declares in interpreters of their own, which may die or hang."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from gem_core import specs
from gem_core.arguments import check_arguments
from gem_core.entry_points import load_entry_point
from gem_core.errors import GemError, RegistrationError
from gem_core.hookspecs import ENTRY_POINT_GROUP
from gem_core.plugins import Record, one_line
from gem_core.requirements import unmet
from gem_core.specs import CommandSpec, EnvSpec, NamedSpec, ToolSpec, WrapperSpec
from gem_core.testing.places import place_of, shown_place

TIMEOUT_S = 120.0
"""How long the imports of one plugin may take, all together, by default."""


@dataclass
class Imported:
    """What was seen of a plugin.

    Args:
        failure: Why it could not be loaded, or None.
        packages: Top-level packages that declaring imported, beside the standard library and the core.
        printed: What declaring and importing wrote to standard output.
        records: Of each record the ``name``, the ``summary``, the ``place`` (file and line where it is made) and the
            ``error``, which is empty where its entry point can be used.
    """

    failure: str | None = None
    packages: list[str] = field(default_factory=list)
    printed: str = ""
    records: list[dict[str, str]] = field(default_factory=list)

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


def imported(point: EntryPoint, timeout_s: float = TIMEOUT_S) -> Imported:
    """Load one plugin, without the others, and import every entry point that its records name.

    An entry point that ends or hangs its interpreter is named, and those behind it are tried in another.

    Args:
        point: The plugin.
        timeout_s: Seconds for all of it.
    """
    deadline = time.monotonic() + timeout_s
    seen: Imported | None = None
    tried = 0
    while seen is None or tried < len(seen.records):
        if seen is not None and time.monotonic() >= deadline:
            for record in seen.records[tried:]:
                record["error"] = (
                    f"{record['place']}: not tried, since the imports before it took more than {timeout_s:g} s"
                )
            break
        ended, printed, said = _run(point, tried, deadline)
        if not said:
            return Imported(f"while it was loaded, {ended}", printed=printed)
        loaded, *errors = said
        seen = seen or Imported(**loaded, printed=printed)
        for error in errors:
            seen.records[tried]["error"] = error
            tried += 1
        if tried < len(seen.records):
            record = seen.records[tried]
            record["error"] = f"{record['place']}: while its entry point was imported, {ended}"
            tried += 1
    return seen


def _run(point: EntryPoint, first: int, deadline: float) -> tuple[str, str, list[Any]]:
    """Run an interpreter to its end, or to the deadline; return how it ended, what it printed, and what it said."""
    own = _distribution(point)
    others = [other for other in entry_points(group=ENTRY_POINT_GROUP) if other != point]
    disabled = {name for other in others for name in (other.name, _distribution(other))} - {point.name, own}
    variables = {name: value for name, value in os.environ.items() if name != "GEM_PLUGINS_STRICT"}
    variables |= {
        "GEM_PLUGINS_DISABLE": ",".join(sorted(disabled)),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    with tempfile.TemporaryDirectory(prefix="gem-check-") as folder:
        printed, complained, said = (Path(folder) / name for name in ("printed", "complained", "said"))
        asked = {"name": point.name, "distribution": own, "first": first, "path": sys.path, "said": str(said)}
        said.touch()
        with printed.open("wb") as out, complained.open("wb") as err:
            # Files and not pipes, and a session of its own: what it starts may outlive it.
            process = subprocess.Popen(
                [sys.executable, "-c", f"from {__name__} import _report; _report()", json.dumps(asked)],
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
            try:
                code = process.wait(max(0.0, deadline - time.monotonic()))
                ended = f"the interpreter ended with exit code {code}"
            except subprocess.TimeoutExpired:
                ended = "it took too long"
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        last = complained.read_text(errors="replace").strip().splitlines()[-1:]
        lines = said.read_text().splitlines(keepends=True)
        return (
            ended + (f": {last[0][:200]}" if last else ""),
            printed.read_text(errors="replace"),
            [json.loads(line) for line in lines if line.endswith("\n")],
        )


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else ""


# In the other interpreter.


def _report() -> None:
    """Load the plugin that was asked for, then import its entry points one by one; say each thing once it is known."""
    asked = json.loads(sys.argv[1])
    sys.path[:] = asked["path"]
    import pluggy  # noqa: F401 - what the loader itself needs is no import of the plugin's

    from gem_core.registry import registry

    places = _noting_places()
    before = set(sys.modules)
    plugin = next(
        plugin
        for plugin in registry().plugins()
        if plugin.name == asked["name"] and asked["distribution"] in ("", plugin.distribution)
    )
    packages = {name.partition(".")[0] for name in set(sys.modules) - before}
    packages -= {*sys.stdlib_module_names, "gem_core", "pluggy"}
    loaded = {
        "failure": None if plugin.failure is None else plugin.failure.error,
        "packages": sorted(name for name in packages if not name.startswith("__editable__")),
        "records": [
            {"name": _name(record), "summary": record.summary, "place": places.get(id(record), ""), "error": ""}
            for record in plugin.records
        ],
    }
    with open(asked["said"], "a", encoding="utf-8") as file:
        print(json.dumps(loaded), file=file, flush=True)
        for record in plugin.records[asked["first"] :]:
            print(json.dumps(_error_of(record, places.get(id(record), ""))), file=file, flush=True)
    sys.stdout.flush()
    os._exit(0)  # threads and exit handlers of what was imported are nobody's concern


def _name(record: Record) -> str:
    return record.id if isinstance(record, EnvSpec) else f"{record.kind} {record.name}"


def _noting_places() -> dict[int, str]:
    """Note from now on where each record is made, by its ``id()``."""
    places: dict[int, str] = {}

    def noting(check: Callable[[Any], None]) -> Callable[[Any], None]:
        def noted(record: Any) -> None:
            frame = sys._getframe(1)
            while frame.f_back is not None and frame.f_globals.get("__name__") in (specs.__name__, "dataclasses"):
                frame = frame.f_back
            places[id(record)] = shown_place(frame.f_code.co_filename, frame.f_lineno)
            check(record)

        return noted

    EnvSpec.__post_init__ = noting(EnvSpec.__post_init__)  # type: ignore[assignment, method-assign]
    NamedSpec.__post_init__ = noting(NamedSpec.__post_init__)  # type: ignore[assignment, method-assign]
    return places


def _error_of(record: Record, declared: str) -> str:
    """Return what is wrong with the entry points of a record, and where; ``""`` where nothing is.

    Args:
        record: What is tried.
        declared: File and line where it is made.
    """
    try:
        maker = load_entry_point(record.entry_point, "its entry point")
        if isinstance(record, ToolSpec) and record.status is not None:
            load_entry_point(record.status, "its status")
        if isinstance(record, EnvSpec):
            check_arguments(maker, (), {k: v for k, v in record.kwargs.items() if k != "render_mode"}, "its kwargs")
        _check_kind(record, maker)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a plugin's module does is what was seen
        cause = error.__cause__ or error
        foreign = (
            error.__cause__ is not None
            and isinstance(cause, ImportError)
            and (cause.name or "").partition(".")[0] != _package(record)
        )
        if foreign and isinstance(record, EnvSpec) and unmet(record.requires):
            return ""  # what it needs is not here, and that is what its module imports
        inside = place_of(cause, _package(record)) if error.__cause__ is not None else ""
        text = f"{error}" if isinstance(error, GemError) else one_line(error)
        return f"{inside or declared}: {' '.join(text.split())}"
    return ""


def _package(record: Record) -> str:
    point = record.entry_point
    module = point if isinstance(point, str) else str(getattr(point, "__module__", ""))
    return module.partition(":")[0].partition(".")[0]


def _check_kind(record: Record, maker: Any) -> None:
    """Refuse what is found and is no environment, tool, wrapper, backend or command."""
    if isinstance(record, CommandSpec):
        import click

        if not isinstance(maker, click.Command):
            raise RegistrationError(f"{record.entry_point!r} is a {type(maker).__name__}, and no click.Command")
    elif isinstance(maker, type):
        base = _base_of(record)
        if base is not None and not issubclass(maker, base):
            raise RegistrationError(f"{record.entry_point!r} does not derive from {base.__module__}.{base.__name__}")


def _base_of(record: Record) -> type | None:
    """Return what a class that a record names must derive from."""
    import gymnasium

    if isinstance(record, EnvSpec):
        return gymnasium.Env
    if isinstance(record, WrapperSpec):
        return gymnasium.Wrapper
    if isinstance(record, ToolSpec):
        from gem_core.tools import Tool

        return Tool
    return None
