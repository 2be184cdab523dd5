"""Run programs in the Python sandbox of gem-tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gem_code.runner import NoVerdictError, ProgramLimits, ProgramRun
from gem_core.errors import ArgumentError, GemError

if TYPE_CHECKING:
    from gem_tools.python import Pool


class SandboxRunner:
    """A ``Runner`` on the sandboxes that all of this process share; they start with the first program.

    Args:
        sandbox: Level of isolation; see ``gem_tools.python``.
    """

    def __init__(self, sandbox: str = "auto") -> None:
        self.sandbox = sandbox
        # Says now, and not at the first program, that there is no such level; starts nothing.
        _ = self.pool

    @property
    def pool(self) -> Pool:
        """The sandboxes, which a forked process has of its own."""
        from gem_tools.python import shared_pool

        return shared_pool(sandbox=self.sandbox)

    async def run(self, program: str, stdin: str, limits: ProgramLimits) -> ProgramRun:
        """See ``Runner``."""
        from gem_tools.python import Limits

        allowed = Limits(
            wall_s=limits.wall_s,
            cpu_s=limits.cpu_s,
            memory_mb=limits.memory_mb,
            output_bytes=limits.output_bytes,
        )
        try:
            outcome = await self.pool.arun(program, stdin=stdin, limits=allowed)
        except ArgumentError:
            raise
        except GemError as error:
            raise NoVerdictError(f"the sandbox failed: {error}") from error
        # The sandbox keeps the head and the tail of a long output, which is no output to compare.
        status = "output" if outcome.dropped[0] and outcome.status == "ok" else outcome.status
        return ProgramRun(status, outcome.exit_code, outcome.stdout, outcome.error, outcome.sandbox)
