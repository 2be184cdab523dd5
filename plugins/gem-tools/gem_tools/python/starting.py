"""Which level is taken, and why not a stronger one."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gem_core.errors import ArgumentError, MissingRequirementError
from gem_tools.python.cell import Cell, wait_for_end
from gem_tools.python.errors import SandboxError
from gem_tools.python.levels import DOCKER_IMAGE, LEVELS, Launch, Unavailable, launches

AUTO = "auto"
_ANSWER_S = 10.0
_DOCKER_MEMORY_MB = 4096

_working: dict[str, int] = {}
"""The way of each level that has worked in this process, so that no other is tried again."""


filtered: dict[str, bool] = {}
"""Whether the levels that have worked filter system calls; a rare processor or an old kernel has no filter."""


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
            launch, note = await _working_way(level, settings, asked_for=sandbox != AUTO)
        except Unavailable as reason:
            passed_over[level] = str(reason)
        else:
            return Chosen(level, launch, note, passed_over)
    reasons = "; ".join(f"{level}: {reason}" if sandbox == AUTO else reason for level, reason in passed_over.items())
    raise MissingRequirementError(f"the Python sandbox {sandbox!r} cannot run here: {reasons}")


async def _working_way(level: str, settings: Mapping[str, Any], *, asked_for: bool) -> tuple[Callable[[], Launch], str]:
    """Try the ways of a level until one starts."""
    if level == "docker" and level not in _working:
        _check_docker(settings["image"], asked_for=asked_for)
    ways = launches(level, settings)
    known = _working.get(level)
    reasons = []
    for number, way in enumerate(ways):
        if known is not None and number != known:
            continue
        try:
            launch = way()
            if known is None:
                filtered[level] = await _try(launch)
        except Unavailable as reason:
            reasons.append(str(reason))
        except SandboxError as error:
            reasons.append(_advice(level, str(error)))
        else:
            _working[level] = number
            return way, launch.note
    raise Unavailable("; ".join(dict.fromkeys(reasons)))


async def _try(launch: Launch) -> bool:
    """Start a sandbox, run nothing in it, and end it; return whether it filters system calls."""
    settings = {**launch.settings, "preload": []}
    cell = Cell(Launch(launch.level, launch.command, settings, launch.popen, launch.base, launch.note), lambda _: None)
    await cell.start()
    limits = {"folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
    limits |= {"wall_s": 30.0, "cpu_s": 30.0, "memory_mb": 512, "processes": 8, "open_files": 64, "file_mb": 8}
    limits |= {"output_bytes": 1024, "output_stop_bytes": 65536, "value_chars": 100, "session": False}
    job = b'{"code": "", "stdin": "", "files": {}, "value": false, "most": 100}'
    try:
        answer, output = await cell.ask({"op": "run", "id": 0, "limits": limits}, job)
    finally:
        cell.close()
        if launch.base is not None and cell.process is not None:
            remove_when_ended(cell.process, launch.base)
    if answer["failed"] is not None or answer["status"] != 0:
        words = " ".join(output.decode("utf-8", "replace").split())[-600:]
        raise SandboxError(f"the sandbox does not work: {answer['failed'] or words}")
    return cell.filtered


def _advice(level: str, error: str) -> str:
    if level == "bubblewrap":
        return f"{error}. Allow unprivileged user namespaces on this system, or name another level"
    return error


def _check_docker(image: str, *, asked_for: bool) -> None:
    """See to it that an engine answers and has the image, which is never pulled unasked."""
    program = shutil.which("docker")
    if program is None:
        raise Unavailable("the command 'docker' is not on the PATH: install Docker's client and start an engine")
    try:
        done = subprocess.run(
            [program, "image", "inspect", "--format", "{{.Id}}", image],
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=_ANSWER_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Unavailable(f"the container engine does not answer ({type(error).__name__}): start it") from error
    if done.returncode:
        words = " ".join(done.stderr.decode("utf-8", "replace").split())[:200]
        raise Unavailable(f"the image {image!r} is not there: 'docker pull {image}' ({words})")


def remove_when_ended(process: subprocess.Popen[bytes], base: str) -> None:
    """Remove a sandbox's folder once it has ended, which it does itself unless it was killed."""

    def work() -> None:
        wait_for_end(process, _ANSWER_S)
        if os.path.isdir(base):
            from gem_tools.python.inside.folders import Folders

            with contextlib.suppress(OSError):
                Folders(base).remove_all()

    threading.Thread(target=work, name="gem-python-folder", daemon=True).start()
