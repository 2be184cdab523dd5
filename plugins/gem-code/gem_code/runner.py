"""Run programs in the Python sandbox of gem-tools: the one place where gem-code meets it."""

from __future__ import annotations

from dataclasses import replace

from gem_core.errors import ArgumentError, GemError, GradingError
from gem_tools.python import Limits, Outcome, shared_pool


class NoVerdictError(GradingError):
    """The sandbox failed, and would have with any program: there is no verdict."""


class Runner:
    """Runs programs, any number at once; each as ``__main__``, out of reach of the others and of this process.

    Args:
        sandbox: Level of isolation; see ``gem_tools.python``. Sandboxes start with the first program, for all of this
            process together.
    """

    def __init__(self, sandbox: str = "auto") -> None:
        self.sandbox = sandbox
        # Says now, and not at the first program, that there is no such level; starts nothing.
        shared_pool(sandbox=sandbox)

    async def run(self, program: str, stdin: str, limits: Limits) -> Outcome:
        """Run a program to its end, or to the first limit that it meets.

        Raises:
            NoVerdictError: It could not be run, whatever the program is.
        """
        try:
            outcome = await shared_pool(sandbox=self.sandbox).arun(program, stdin=stdin, limits=limits)
        except ArgumentError:
            raise
        except GemError as error:
            raise NoVerdictError(f"the sandbox failed: {error}") from error
        # The sandbox keeps the head and the tail of a long output, which is no output to compare.
        return replace(outcome, status="output") if outcome.dropped[0] and outcome.status == "ok" else outcome
