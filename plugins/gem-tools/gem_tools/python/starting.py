"""Which level is taken, and why not a stronger one."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import dataclasses
import functools
import json
import logging
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gem_core.errors import ArgumentError, MissingRequirementError
from gem_tools.python import docker, groups
from gem_tools.python.cell import Cell, wait_for_end
from gem_tools.python.errors import SandboxError, Unavailable
from gem_tools.python.levels import DOCKER_IMAGE, LEVELS, Launch, launches

if TYPE_CHECKING:
    import subprocess

AUTO = "auto"
_ANSWER_S = 10.0
_DOCKER_MEMORY_MB = 4096

_working: dict[tuple[str, str], int] = {}
"""The way of each level, and image, that has worked in this process, so that no other is tried again."""


walled: dict[str, bool] = {}
"""Whether Landlock keeps code to its folder on the levels that have worked; those with namespaces do without."""

logger = logging.getLogger("gem_tools")

_warned: list[str] = []

filtered: dict[str, bool] = {}
"""Whether the levels that have worked filter system calls; a rare processor or an old kernel has no filter."""


interpreters: dict[tuple[str, str], Interpreter] = {}
"""What Python the levels have that have worked, by name and image."""

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
        launch: Returns how one more sandbox is started.
        note: What is special about it here.
        passed_over: Why no stronger level was taken, by name.
    """

    level: str
    launch: Callable[[], Launch]
    note: str
    passed_over: Mapping[str, str]


def check_level(sandbox: str) -> None:
    """Refuse what is no level.

    Raises:
        ArgumentError: It is none.
    """
    if sandbox not in (AUTO, *LEVELS):
        raise ArgumentError(f"sandbox must be one of {', '.join([AUTO, *LEVELS])}, not {sandbox!r}")


def options(*, preload: Sequence[str], folder_mb: int, folder_files: int, image: str | None) -> dict[str, Any]:
    """Return what the levels need to know."""
    return {
        "preload": list(dict.fromkeys(preload)),
        "folder_mb": folder_mb,
        "folder_files": folder_files,
        "image": image or DOCKER_IMAGE,
        "docker_memory_mb": _DOCKER_MEMORY_MB,
    }


async def chosen(sandbox: str, settings: Mapping[str, Any]) -> Chosen:
    """Return the level to use: the one that is named, or the strongest that works here.

    Raises:
        MissingRequirementError: It does not work here; the message says why and what to do.
    """
    passed_over: dict[str, str] = {}
    for level in LEVELS if sandbox == AUTO else (sandbox,):
        try:
            launch, note = await _working_way(level, settings)
        except Unavailable as reason:
            passed_over[level] = str(reason)
        else:
            return Chosen(level, launch, note, passed_over)
    reasons = "; ".join(f"{level}: {reason}" if sandbox == AUTO else reason for level, reason in passed_over.items())
    raise MissingRequirementError(f"the Python sandbox {sandbox!r} cannot run here: {reasons}")


async def _working_way(level: str, settings: Mapping[str, Any]) -> tuple[Callable[[], Launch], str]:
    """Try the ways of a level until one starts."""
    key = _key(level, settings)
    if level == "docker":
        # In a thread: an engine that hangs must not keep other pools waiting.
        await asyncio.to_thread(docker.check, settings["image"])
    ways = launches(level, settings)
    known = _working.get(key)
    reasons = []
    for number, way in enumerate(ways):
        if known is not None and number != known:
            continue
        try:
            launch = way()
            if known is None:
                filtered[level], walled[level], interpreters[key] = await _try(launch)
        except Unavailable as reason:
            reasons.append(str(reason))
        except SandboxError as error:
            reasons.append(_advice(level, str(error)))
        else:
            _working[key] = number
            return way, launch.note
    raise Unavailable("; ".join(dict.fromkeys(reasons)))


def _key(level: str, settings: Mapping[str, Any]) -> tuple[str, str]:
    return level, settings["image"] if level == "docker" else ""


async def _try(launch: Launch) -> tuple[bool, bool, Interpreter]:
    """Start a sandbox, look round in it, and end it.

    Returns:
        Whether it filters system calls, whether it has Landlock, and its Python.
    """
    settings = {**launch.settings, "preload": ["inspect", "json", "pkgutil"]}
    cell = Cell(dataclasses.replace(launch, settings=settings), end_of)
    await cell.start()
    limits = {"folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
    limits |= {"wall_s": 30.0, "cpu_s": 30.0, "memory_mb": 512, "processes": 8, "open_files": 64, "file_mb": 8}
    limits |= {"output_bytes": 1 << 20, "output_stop_bytes": 1 << 21, "value_chars": 100, "session": False}
    job = json.dumps({"code": _LOOK, "stdin": "", "files": {}, "value": False, "most": 100}).encode("ascii")
    try:
        answer, output = await cell.ask({"op": "run", "id": 0, "limits": limits}, job)
    finally:
        cell.close()
        if cell.process is not None:
            await asyncio.to_thread(wait_for_end, cell.process, _ANSWER_S)
    if answer["failed"] is not None or answer["status"] != 0:
        words = " ".join(output.decode("utf-8", "replace").split())[-600:]
        raise SandboxError(f"the sandbox does not work: {answer['failed'] or words}")
    try:
        version, modules = json.loads(output[: answer["lengths"][0]])
    except ValueError as error:
        raise SandboxError("the sandbox does not work: its Python does not print what it is told to") from error
    return cell.filtered, cell.walled, Interpreter(version, frozenset(modules))


@functools.cache
def interpreter(sandbox: str, image: str | None) -> Interpreter | None:
    """Return the Python that code will run in, from plain code on any thread; None where no sandbox can be had.

    It is found out once in a process, by the start of a sandbox that the first call would need in any case.
    """
    settings = options(preload=(), folder_mb=1, folder_files=64, image=image)
    # In a thread with a loop of its own: the caller may be on an event loop itself.
    with concurrent.futures.ThreadPoolExecutor(1, "gem-python-look") as thread:
        try:
            found = thread.submit(asyncio.run, chosen(sandbox, settings)).result()
        except MissingRequirementError:  # which every call tells
            return None
    return interpreters[_key(found.level, settings)]


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


def _advice(level: str, error: str) -> str:
    if level == "bubblewrap":
        return f"{error}. Allow unprivileged user namespaces on this system, or name another level"
    return error


def end_of(cell: Cell) -> None:
    """See a sandbox that is gone to its end, without waiting."""
    if cell.process is not None and any((cell.launch.base, cell.launch.container, cell.launch.group)):
        ending = (cell.process, cell.launch, _ANSWER_S)
        threading.Thread(target=wait_and_clear, args=ending, name="gem-python-end", daemon=True).start()


def wait_and_clear(process: subprocess.Popen[bytes], launch: Launch, limit_s: float) -> None:
    """Wait for a sandbox to end, then remove what it left, which is nothing unless it was killed."""
    wait_for_end(process, limit_s)
    if launch.base is not None and os.path.isdir(launch.base):
        from gem_tools.python.inside.folders import Folders

        with contextlib.suppress(OSError):
            Folders(launch.base).remove_all()
    if launch.group is not None:
        groups.remove(launch.group)
    if launch.container is not None and process.returncode:
        docker.remove(launch.container)
