"""Tests that install programs from a network that their task does not ask for: told when the task is read."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task, Verifier

_MOST_BYTES = 200_000
INSTALLS = re.compile(
    r"^[^#\n]*?\b(?P<what>apt(?:-get)?\s++(?:-\S++\s++){0,5}(?:update|install)|apk\s++add|dnf\s++install|"
    r"pip3?\s++install|uvx|uv\s++(?:run|add|sync|tool|pip|init)|npm\s++(?:install|ci)|npx|git\s++clone\s++https?|"
    r"(?:curl|wget)\b[^\n]{0,200}?https?://(?!localhost|127\.|\[::1\]|0\.0\.0\.0))",
    re.MULTILINE,
)
_OFFLINE = ("--no-index", "--offline", "--find-links")


def with_network_note(task: Task) -> Task:
    """Return a task, with a note where the script of its tests installs programs and the tests have no network.

    Such a script often rewards with 0 what it could not test: no verdict tells that apart from a failure.
    """
    notes = []
    for step in task.steps:
        verifier = step.verifier
        network = task.environment.network if verifier.environment is None else verifier.environment.network
        script = _script(verifier)
        if (verifier.network or network or "none") != "none" or script is None:
            continue
        if what := _installs(script):
            name = script.relative_to(task.folder).as_posix() if script.is_relative_to(task.folder) else script.name
            notes.append(
                f"{name}: needs a network for {what!r}, it seems, and the task asks for none: "
                "network='public' gives it one, the agent included."
            )
    return replace(task, notes=(*task.notes, *dict.fromkeys(notes))) if notes else task


def _script(verifier: Verifier) -> Path | None:
    """Return the host's file of the script that runs the tests."""
    at = verifier.command[-1] if verifier.command else ""
    if at in verifier.files:
        return verifier.files[at]
    folder, _, name = at.rpartition("/")
    return verifier.files[folder] / name if folder in verifier.files else None


def _installs(script: Path) -> str:
    """Return what a script runs to install something; empty where it does not."""
    try:
        with script.open("rb") as file:
            text = file.read(_MOST_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""
    for found in INSTALLS.finditer(text):
        end = text.find("\n", found.end())
        if not any(word in text[found.start() : end if end >= 0 else len(text)] for word in _OFFLINE):
            return " ".join(found["what"].split())[:60]
    return ""
