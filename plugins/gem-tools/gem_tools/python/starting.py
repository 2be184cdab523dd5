"""Which level is taken, and why not a stronger one."""

from __future__ import annotations

import asyncio
import concurrent.futures
import dataclasses
import functools
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gem_core.docs import page_url
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_tools.python import docker
from gem_tools.python.errors import SandboxError, Unavailable
from gem_tools.python.levels import DOCKER_IMAGE, LEVELS, launch
from gem_tools.python.limits import Limits
from gem_tools.python.sandbox import Sandbox

AUTO = "auto"
_ADVICE = {"bubblewrap": ". Allow unprivileged user namespaces on this system, or name another level"}

logger = logging.getLogger("gem_tools")

_LOOK = """
import json, pkgutil, sys
names = {module.name for module in pkgutil.iter_modules()} - sys.stdlib_module_names
print(json.dumps(["%d.%d" % sys.version_info[:2], sorted(name for name in names if name[0] != "_")]))
"""


@dataclass(frozen=True)
class Interpreter:
    """The Python of a level.

    Args:
        version: As in ``"3.12"``.
        modules: What can be imported besides the standard library, top-level names.
    """

    version: str
    modules: frozenset[str]


@dataclass(frozen=True)
class Chosen:
    """A level that works.

    Args:
        level: Its name.
        note: What is special about it here.
        filtered: Whether system calls are filtered; a rare processor or an old kernel has no filter.
        walled: Whether Landlock keeps code to its folder; levels with namespaces do without.
        python: Its interpreter.
        passed_over: Why no stronger level was taken, by name.
    """

    level: str
    note: str
    filtered: bool
    walled: bool
    python: Interpreter
    passed_over: Mapping[str, str] = field(default_factory=dict)


_working: dict[tuple[str, str], Chosen] = {}
"""What has worked in this process, by level and image, so that it is tried once."""

_warned: list[str] = []


def options(*, preload: Sequence[str] = (), folder_mb: int = 1, image: str | None = None) -> dict[str, Any]:
    """Return what the levels need to know."""
    return {
        "preload": list(dict.fromkeys(preload)),
        "folder_mb": folder_mb,
        "folder_files": Limits.folder_files,
        "image": image or DOCKER_IMAGE,
    }


def check_level(sandbox: str) -> None:
    """Refuse what is no level.

    Raises:
        ArgumentError: It is none.
    """
    if sandbox not in (AUTO, *LEVELS):
        raise ArgumentError(f"sandbox must be one of {', '.join([AUTO, *LEVELS])}, not {sandbox!r}")


async def chosen(sandbox: str, settings: Mapping[str, Any]) -> Chosen:
    """Return the level to use: the one that is named, or the strongest that works here.

    Raises:
        MissingRequirementError: It does not work here; the message says why and what to do.
    """
    passed_over: dict[str, str] = {}
    for level in LEVELS if sandbox == AUTO else (sandbox,):
        try:
            found = await _found(level, settings)
        except Unavailable as reason:
            passed_over[level] = str(reason)
        else:
            return dataclasses.replace(found, passed_over=passed_over)
    reasons = "; ".join(f"{level}: {reason}" if sandbox == AUTO else reason for level, reason in passed_over.items())
    raise MissingRequirementError(
        f"the Python sandbox {sandbox!r} cannot run here: {reasons}. See {page_url('python-tool/#levels')}"
    )


async def _found(level: str, settings: Mapping[str, Any]) -> Chosen:
    """Return a level, tried once in this process: start a sandbox, ask for its Python and packages, and end it."""
    key = level, settings["image"] if level == "docker" else ""
    if level == "docker":
        # In a thread: an engine that hangs must not keep other pools waiting.
        await asyncio.to_thread(docker.check, settings["image"])
    if key in _working:
        return _working[key]
    found = launch(level, {**settings, "preload": ["inspect", "json", "pkgutil"]})
    cell = Sandbox(found)
    limits = Limits(wall_s=30.0, folder_mb=settings["folder_mb"], folder_files=settings["folder_files"])
    job = json.dumps({"code": _LOOK, "files": {}, "value": False, "most": 100}).encode("ascii")
    header = {"op": "run", "id": 0, "limits": limits.told(session=False), "job": len(job), "input": 0}
    try:
        await cell.start()
        answer, (out, err, _) = await cell.ask(header, job)
        if answer["failed"] is not None or answer["status"] != 0:
            raise SandboxError(f"the sandbox does not work: {answer['failed'] or (out.text() + err.text())[-600:]}")
        version, modules = json.loads(out.text())
    except (SandboxError, ValueError) as error:
        raise Unavailable(f"{error}{_ADVICE.get(level, '')}") from error
    finally:
        cell.close()
        await asyncio.to_thread(cell.clear)
    python = Interpreter(version, frozenset(modules))
    _working[key] = Chosen(level, found.note, cell.ready["filtered"], cell.ready["walled"], python)
    return _working[key]


@functools.cache
def interpreter(sandbox: str, image: str | None) -> Interpreter | None:
    """Return the Python that code will run in, from plain code on any thread; None where no sandbox can be had.

    It is found out once in a process, by the start of a sandbox that the first call would need in any case.
    """
    # In a thread with a loop of its own: the caller may be on an event loop itself.
    with concurrent.futures.ThreadPoolExecutor(1, "gem-python-look") as thread:
        try:
            return thread.submit(asyncio.run, chosen(sandbox, options(image=image))).result().python
        except MissingRequirementError:  # which every call tells
            return None


def warn_of_process(chosen: Chosen) -> None:
    """Warn once that ``auto`` has come down to the weakest level."""
    if chosen.level != LEVELS[-1] or not chosen.passed_over or _warned:
        return
    _warned.append(chosen.level)
    reasons = "; ".join(f"{level}: {reason}" for level, reason in chosen.passed_over.items())
    # No Python warning: where those are errors, it would end a call.
    logger.warning(
        "gem: Python code of agents runs on the weakest level, %r (%s), for none that is stronger works here (%s). "
        "Mend that, or name the level: sandbox=%r",
        chosen.level,
        chosen.note,
        reasons,
        chosen.level,
    )
