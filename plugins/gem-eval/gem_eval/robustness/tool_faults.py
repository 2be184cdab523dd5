"""``tool_429`` and ``tool_timeout``: tools whose calls fail now and then, as those of a busy service do."""

from __future__ import annotations

from typing import ClassVar

from gem_core.env import AnyEnv
from gem_core.tools import ToolResult
from gem_eval.robustness.changed_tool import ChangedTool
from gem_eval.robustness.perturbation import Perturbation, tool_env_in


class _ToolFaults(Perturbation):
    """Lets calls of tools fail at random before they are executed; a subclass says how.

    The tool is not called, so that nothing happens twice when the agent tries again.
    """

    fault: ClassVar[str]
    told: ClassVar[str]

    def __init__(self, env: AnyEnv, rate: float = 0.2) -> None:
        super().__init__(env, rate)
        tool_env_in(env, type(self).__name__).change_tools(lambda tool: ChangedTool(tool, before=self._fail))

    def _fail(self) -> ToolResult | None:
        return ToolResult(self.told, failed=True, info={"fault": self.fault}) if self.happens() else None


class Tool429(_ToolFaults):
    """Answers some calls of tools with HTTP status 429 instead of executing them.

    A call that fails counts as a use and earns no ``tool_error_reward``; ``info["tool"]["fault"]`` names the cause.

    Args:
        env: An environment with tools.
        rate: Probability that a call fails.

    Raises:
        ArgumentError: There are no tools inside, or the rate is no number from 0 to 1.
    """

    fault = "HTTP 429, injected"
    told = "The tool failed: HTTP 429 Too Many Requests. The service is busy; try again."


class ToolTimeout(_ToolFaults):
    """Answers some calls of tools as if they had run out of time, and does not execute them.

    A call that fails counts as a use and earns no ``tool_error_reward``; ``info["tool"]["fault"]`` names the cause.

    Args:
        env: An environment with tools.
        rate: Probability that a call fails.

    Raises:
        ArgumentError: There are no tools inside, or the rate is no number from 0 to 1.
    """

    fault = "timeout, injected"
    told = "The tool did not answer within 30 s, and the call was given up."
