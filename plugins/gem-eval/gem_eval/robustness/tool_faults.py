"""``tool_429`` and ``tool_timeout``: tools whose calls fail now and then, as those of a busy service do."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from typing import Any, ClassVar

from gem_core.env import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.tools import Tool, ToolResult, find_tool_env
from gem_eval.robustness.perturbation import Perturbation


class _ToolFaults(Perturbation):
    """Lets calls of tools fail at random before they are executed; a subclass says how.

    The tool is not called, so that nothing happens twice when the agent tries again.
    """

    fault: ClassVar[str]
    told: ClassVar[str]

    def __init__(self, env: AnyEnv, rate: float = 0.2) -> None:
        super().__init__(env, rate)
        found = find_tool_env(env)
        if found is None:
            name = env.unwrapped.spec.id if env.unwrapped.spec is not None else type(env.unwrapped).__name__
            raise ArgumentError(
                f"{type(self).__name__} changes tools that wrappers offer, and there are none inside it around {name}; "
                "name tools before it, as in 'python,tool_429'"
            )
        found.change_tools(lambda tool: _fallible(tool, self._fail))

    def _fail(self) -> ToolResult | None:
        return ToolResult(self.told, failed=True, info={"fault": self.fault}) if self.happens() else None


def _fallible(tool: Tool, fail: Callable[[], ToolResult | None]) -> Tool:
    """Return the tool with calls that fail instead of being executed, where ``fail`` returns a result."""

    def call(arguments: Any, session: Any) -> Any:
        return fail() or tool.call(arguments, session)

    async def call_async(arguments: Any, session: Any) -> Any:
        return fail() or await tool.call(arguments, session)  # type: ignore[misc]  # it is a coroutine function

    changed = copy.copy(tool)
    vars(changed).update(
        call=call_async if inspect.iscoroutinefunction(tool.call) else call,
        # A fork draws by the counter of its own wrapper.
        __deepcopy__=lambda memo: _fallible(tool, copy.deepcopy(fail, memo)),
    )
    return changed


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
