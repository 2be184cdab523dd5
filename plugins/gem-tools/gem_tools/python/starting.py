"""Which level is taken, and why not a stronger one."""

from __future__ import annotations

import asyncio
import concurrent.futures
import functools
import logging
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.docs import page_url
from gem_core.errors import MissingRequirementError
from gem_tools.python import docker
from gem_tools.python.errors import SandboxError, Unavailable
from gem_tools.python.levels import LEVELS, launch
from gem_tools.python.sandbox import Sandbox

AUTO = "auto"
_ADVICE = {"bubblewrap": ". Allow unprivileged user namespaces on this system, or name another level"}

logger = logging.getLogger("gem_tools")

_warned: list[str] = []


async def start(
    sandbox: str, options: Mapping[str, Any], lost: Callable[[Sandbox], None] = lambda sandbox: None
) -> tuple[Sandbox, dict[str, str]]:
    """Start a sandbox of the level that is named, or of the strongest that works here.

    Returns:
        The sandbox, and why no stronger level was taken, by name.

    Raises:
        MissingRequirementError: It does not work here; the message says why and what to do.
    """
    passed_over: dict[str, str] = {}
    for level in LEVELS if sandbox == AUTO else (sandbox,):
        try:
            if level == "docker":
                # In a thread: an engine that hangs must not keep other pools waiting.
                await asyncio.to_thread(docker.check, options["image"])
            found = Sandbox(launch(level, options), lost)
        except Unavailable as reason:
            passed_over[level] = str(reason)
            continue
        try:
            await found.start()
        except SandboxError as reason:
            passed_over[level] = f"{reason}{_ADVICE.get(level, '')}"
            await asyncio.to_thread(found.clear)
        else:
            return found, passed_over
    reasons = "; ".join(f"{level}: {reason}" if sandbox == AUTO else reason for level, reason in passed_over.items())
    raise MissingRequirementError(
        f"the Python sandbox {sandbox!r} cannot run here: {reasons}. See {page_url('python-tool/#levels')}"
    )


@functools.cache
def interpreter(sandbox: str, image: str) -> Mapping[str, Any] | None:
    """Return ``python``, the version that code will run in, and ``modules``, what it can import; None without any.

    It is found out once in a process, by the start of a sandbox, from plain code on any thread.
    """

    async def look() -> Mapping[str, Any]:
        options = {"preload": [], "folder_mb": 1, "folder_files": 4096, "image": image}
        found, _ = await start(sandbox, options)
        found.close()
        await asyncio.to_thread(found.clear)
        return found.ready

    # In a thread with a loop of its own: the caller may be on an event loop itself.
    with concurrent.futures.ThreadPoolExecutor(1, "gem-python-look") as thread:
        try:
            return thread.submit(asyncio.run, look()).result()
        except MissingRequirementError:  # which every call tells
            return None


def warn_of_process(chosen: Sandbox, passed_over: Mapping[str, str]) -> None:
    """Warn once that ``auto`` has come down to the weakest level."""
    level, note = chosen.launch.level, chosen.launch.note
    if level != LEVELS[-1] or not passed_over or _warned:
        return
    _warned.append(level)
    reasons = "; ".join(f"{each}: {reason}" for each, reason in passed_over.items())
    # No Python warning: where those are errors, it would end a call.
    logger.warning(
        "gem: Python code of agents runs on the weakest level, %r (%s), for none that is stronger works here (%s). "
        "Mend that, or name the level: sandbox=%r",
        level,
        note,
        reasons,
        level,
    )
