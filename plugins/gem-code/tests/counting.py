"""The sandbox, and how many programs it was given."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gem_code.runner import Runner

if TYPE_CHECKING:
    from gem_tools.python import Limits, Outcome


class CountingRunner(Runner):
    """Counts the programs that it runs."""

    runs = 0

    async def run(self, program: str, stdin: str, limits: Limits) -> Outcome:
        """Run one."""
        self.runs += 1
        return await super().run(program, stdin, limits)
