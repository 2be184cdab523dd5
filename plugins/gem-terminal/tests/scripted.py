"""A shell and a verifier that do what a test says: for what the environment makes of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from memory_backend import MemoryBackend

from gem_terminal.shell import CommandResult, ScreenResult
from gem_terminal.verifying.verdict import TestResult, Verdict

PASSED = Verdict(True, 1.0, (TestResult("test_one", True), TestResult("test_two", True)))
HALF = Verdict(False, 0.5, (TestResult("test_one", True, 3.0), TestResult("test_two", False, message="no")))


def result(output: str = "", exit_code: int | None = 0, **more: Any) -> CommandResult:
    """Return what a command did."""
    return CommandResult(output, exit_code, workdir="/app", **more)


@dataclass
class Script:
    """What happens, and what was asked for.

    Args:
        on_run: Called with each command and its limit.
        verdicts: Of the verifier, one after another; the last one stays.
    """

    on_run: Callable[[str, float], CommandResult] = lambda command, limit: result(f"ran {command}\n")
    verdicts: list[Verdict] = field(default_factory=lambda: [PASSED])
    backend: MemoryBackend = field(default_factory=MemoryBackend)
    limits: list[float] = field(default_factory=list)
    shells: list[dict[str, Any]] = field(default_factory=list)
    closed: int = 0
    verified: list[dict[str, Any]] = field(default_factory=list)

    def verify(self, machine: Any, task: Any, step: Any, **options: Any) -> Verdict:
        """Stand for the verifier."""
        self.verified.append(options)
        return self.verdicts.pop(0) if len(self.verdicts) > 1 else self.verdicts[0]

    def shell(self, machine: Any, **options: Any) -> ScriptedShell:
        """Stand for the shell."""
        self.shells.append(options)
        return ScriptedShell(self)


class ScriptedShell:
    """A shell that does what its script says."""

    workdir = "/app"

    def __init__(self, script: Script) -> None:
        self.script = script

    def open(self) -> None:
        """Do nothing."""

    def run(self, command: str, timeout_s: float) -> CommandResult:
        """Note the limit, and do it."""
        self.script.limits.append(timeout_s)
        return self.script.on_run(command, timeout_s)

    def press(self, keys: str, wait_s: float) -> ScreenResult:
        """Show the keys."""
        return ScreenResult(screen=f"typed {keys}", running=True)

    def close(self) -> None:
        """Count."""
        self.script.closed += 1
