"""Imports what an installed plugin declares in interpreters of their own, which may die or hang."""

from __future__ import annotations

import faulthandler
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from gem_core.arguments import check_arguments
from gem_core.errors import GemError, RegistrationError
from gem_core.registry import specs
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.hookspecs import ENTRY_POINT_GROUP
from gem_core.registry.plugins import Record, one_line
from gem_core.registry.requirements import RequirementStatus, unmet
from gem_core.registry.specs import CommandSpec, EnvSpec, NamedSpec, RequirementSpec, ToolSpec, WrapperSpec
from gem_core.testing.places import place_of, shown_place

TIMEOUT_S = 60.0
"""How long the import of one entry point may take by default."""


@dataclass
class Imported:
    """What was seen of a plugin.

    Args:
        failure: Why it could not be loaded, or None.
        packages: Top-level packages that declaring imported, beside the standard library and the core.
        printed: What declaring and importing wrote to standard output.
        records: Of each record the ``name``, the ``module`` of its entry point, the ``summary``, the ``place`` (file
            and line where it is made) and the ``error``, which is empty where its entry point can be used.
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


def imported(point: EntryPoint, timeout_s: float = TIMEOUT_S, stop: threading.Event | None = None) -> Imported:
    """Load one plugin, without the others, and import every entry point that its records name.

    A module that ends or hangs its interpreter is named, and the others are tried in another.

    Args:
        point: The plugin.
        timeout_s: Seconds that each import may take.
        stop: Ends the imports when it is set.
    """
    seen: Imported | None = None
    tried: list[int] = []
    stop = stop or threading.Event()
    while seen is None or (len(tried) < len(seen.records) and not stop.is_set()):
        run = _run(point, tried, timeout_s, stop)
        if not run.said:
            return Imported(f"while it was loaded, {run.ended}", printed=run.printed)
        loaded, *errors = run.said
        seen = seen or Imported(**loaded, printed=run.printed)
        for number, error in errors:
            seen.records[number]["error"] = error
            tried.append(number)
        untried = [number for number in range(len(seen.records)) if number not in tried]
        if untried:
            first = seen.records[untried[0]]
            place = run.place_in(first["module"]) or first["place"]
            for number in untried:  # what else is in that module has the same fate
                if seen.records[number]["module"] == first["module"]:
                    seen.records[number]["error"] = f"{place}: while its entry point was imported, {run.ended}"
                    tried.append(number)
    return seen


@dataclass
class _Run:
    """What one interpreter did.

    Args:
        ended: How it ended, in words.
        printed: What it wrote to standard output.
        complained: What it wrote to standard error.
        said: What it reported: what it loaded, then of each record its number and what is wrong.
    """

    ended: str
    printed: str
    complained: str
    said: list[Any]

    def place_in(self, module: str) -> str:
        """Return file and line where a module's package stood when the interpreter was ended, or crashed."""
        package = re.escape(module.partition(".")[0])
        stood = re.search(rf'File "(.*/{package}(?:/.*|\.py))", line (\d+) in ', self.complained)
        return shown_place(stood[1], int(stood[2])) if stood else ""


def _run(point: EntryPoint, tried: list[int], timeout_s: float, stop: threading.Event) -> _Run:
    """Run an interpreter until it has imported all but what was tried, or an import takes too long."""
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
        asked = {"name": point.name, "distribution": own, "tried": tried, "path": sys.path, "said": str(said)}
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
                code = _wait(process, said, timeout_s, stop)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        complaint = complained.read_text(errors="replace")
        lines = complaint.strip().splitlines()
        last = next((line for line in lines if line.startswith("Fatal Python error: ")), lines[-1] if lines else "")
        ended = f"the interpreter ended with exit code {code}" + (f": {last[:200]}" if last else "")
        return _Run(
            "it took too long" if code is None else ended,
            printed.read_text(errors="replace"),
            complaint,
            [json.loads(line) for line in said.read_text().splitlines(keepends=True) if line.endswith("\n")],
        )


def _wait(process: subprocess.Popen[bytes], said: Path, timeout_s: float, stop: threading.Event) -> int | None:
    """Wait until a process ends, and return its exit code; None where it reported nothing for too long."""
    size, deadline = -1, 0.0
    while not stop.is_set():
        if said.stat().st_size != size:
            size, deadline = said.stat().st_size, time.monotonic() + timeout_s
        try:
            return process.wait(0.1)
        except subprocess.TimeoutExpired:
            if time.monotonic() >= deadline:
                break
    process.send_signal(signal.SIGUSR1)  # it writes where it stands, and ends
    with suppress(subprocess.TimeoutExpired):
        process.wait(1.0)
    return None


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else ""


# In the other interpreter.


def _report() -> None:
    """Load the plugin that was asked for, then import its entry points one by one; say each thing once it is known."""
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1, chain=True)
    asked = json.loads(sys.argv[1])
    sys.path[:] = asked["path"]
    import pluggy  # noqa: F401 - what the loader itself needs is no import of the plugin's

    from gem_core.registry.lookup import registry

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
            {
                "name": _name(record),
                "module": _module(record),
                "summary": record.summary,
                "place": places.get(id(record), ""),
                "error": "",
            }
            for record in plugin.records
        ],
    }
    with open(asked["said"], "a", encoding="utf-8") as file:
        print(json.dumps(loaded), file=file, flush=True)
        for number, record in enumerate(plugin.records):
            if number not in asked["tried"]:
                said = [number, _error_of(record, places.get(id(record), ""))]
                print(json.dumps(said), file=file, flush=True)
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


def _module(record: Record) -> str:
    point = record.entry_point
    module = point if isinstance(point, str) else str(getattr(point, "__module__", ""))
    return module.partition(":")[0]


def _package(record: Record) -> str:
    return _module(record).partition(".")[0]


def _check_kind(record: Record, maker: Any) -> None:
    """Refuse what is no environment, tool, wrapper, backend or command, and a probe that gives no status."""
    if isinstance(record, CommandSpec):
        import click

        if not isinstance(maker, click.Command):
            raise RegistrationError(f"{record.entry_point!r} is a {type(maker).__name__}, and no click.Command")
    elif isinstance(record, RequirementSpec):
        check_arguments(maker, ("",), {"closely": False}, "its probe")
        answer = maker("", closely=False)
        if not isinstance(answer, RequirementStatus):
            raise RegistrationError(f"{record.entry_point!r} returned {answer!r:.100}, and no RequirementStatus")
    elif isinstance(maker, type):
        base = _base_of(record)
        if base is not None and not issubclass(maker, base):
            package = base.__module__.partition(".")[0]
            raise RegistrationError(f"{record.entry_point!r} does not derive from {package}.{base.__name__}")


def _base_of(record: Record) -> type | None:
    """Return what a class that a record names must derive from."""
    import gymnasium

    if isinstance(record, EnvSpec):
        return gymnasium.Env
    if isinstance(record, WrapperSpec):
        return gymnasium.Wrapper
    if isinstance(record, ToolSpec):
        from gem_core.tools.tool import Tool

        return Tool
    return None
