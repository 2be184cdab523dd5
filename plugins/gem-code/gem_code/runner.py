"""Run a program on an input: the one place where gem-code meets the sandbox."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from gem_core.errors import GradingError


class NoVerdictError(GradingError):
    """The sandbox failed, and would have with any program: there is no verdict."""


@dataclass(frozen=True)
class ProgramLimits:
    """What one run of a program may use.

    Args:
        wall_s: Seconds on the clock, waiting included.
        cpu_s: Seconds of computing.
        memory_mb: Megabytes, of all its processes together where the sandbox can tell.
        output_bytes: Bytes that it may print.
    """

    wall_s: float = 10.0
    cpu_s: float = 10.0
    memory_mb: int = 512
    output_bytes: int = 4_000_000


@dataclass(frozen=True)
class ProgramRun:
    """What became of a program.

    Args:
        status: ``"ok"``, ``"error"`` (an exception ended it), ``"exit"`` (it exited by itself, see ``exit_code``),
            ``"timeout"``, ``"cpu"``, ``"memory"``, ``"output"`` (more than it may print) or ``"killed"``.
        exit_code: As the system gives it; None where there is none.
        stdout: What it printed.
        error: Last line of the exception, or what the sandbox says; None where there is nothing to say.
        sandbox: Name of the level of isolation.
    """

    status: str
    exit_code: int | None = None
    stdout: str = ""
    error: str | None = None
    sandbox: str | None = None

    @property
    def finished(self) -> bool:
        """Whether the program came to its end without complaint; ``sys.exit(0)`` is none."""
        return self.status == "ok" or (self.status == "exit" and not self.exit_code)


class Runner(Protocol):
    """Runs programs, any number at once; each as ``__main__``, out of reach of the others and of this process."""

    async def run(self, program: str, stdin: str, limits: ProgramLimits) -> ProgramRun:
        """Run a program to its end, or to the first limit that it meets.

        Raises:
            NoVerdictError: It could not be run, whatever the program is.
        """
        ...
