"""The sandbox, and how many programs it was given."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gem_code.sandbox import SandboxRunner

if TYPE_CHECKING:
    from gem_code.runner import ProgramLimits, ProgramRun


class CountingRunner(SandboxRunner):
    """Counts the programs that it runs."""

    runs = 0

    async def run(self, program: str, stdin: str, limits: ProgramLimits) -> ProgramRun:
        """Run one."""
        self.runs += 1
        return await super().run(program, stdin, limits)
