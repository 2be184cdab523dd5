"""``ChangedTool``: a tool that stands for another, and changes what happens before and after its calls."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from gem_core.tools import Tool, ToolCall, ToolResult
from gem_core.types import Observation

Outcome = ToolResult | Observation


class ChangedTool(Tool):
    """Another tool, described and called as that one is.

    Args:
        tool: The other tool.
        before: Called before each call; what it returns is the result in place of the call, unless it is None.
        after: Called with the result of each call; returns the result for the agent.
    """

    def __init__(
        self,
        tool: Tool,
        *,
        before: Callable[[], ToolResult | None] = lambda: None,
        after: Callable[[ToolResult], ToolResult] = lambda result: result,
    ) -> None:
        self.tool = tool
        self._before, self._after = before, after
        vars(self).update(
            name=tool.name,
            description=tool.description,
            fences=tool.fences,
            concurrency=tool.concurrency,
            # As they are, since it matters whether they are coroutine functions.
            open=tool.open,
            close=tool.close,
            call=self._call_async if inspect.iscoroutinefunction(tool.call) else self._call,
        )

    def _call(self, arguments: Any, session: Any) -> Outcome | Awaitable[Outcome]:
        instead = self._before()
        if instead is not None:
            return instead
        outcome = self.tool.call(arguments, session)
        return self._awaited(outcome) if inspect.isawaitable(outcome) else self._after(as_result(outcome))

    async def _call_async(self, arguments: Any, session: Any) -> Outcome:
        return self._before() or await self._awaited(self.tool.call(arguments, session))

    async def _awaited(self, outcome: Any) -> ToolResult:
        return self._after(as_result(await outcome))

    @property
    def session_key(self) -> str:
        """That of the other tool."""
        return self.tool.session_key

    def __deepcopy__(self, memo: dict[int, Any]) -> ChangedTool:
        # What is called before and after may be methods of a wrapper, of which a fork has its own.
        return ChangedTool(self.tool, before=copy.deepcopy(self._before, memo), after=copy.deepcopy(self._after, memo))

    def parameters_schema(self) -> dict[str, Any]:
        """Return that of the other tool."""
        return self.tool.parameters_schema()

    def validate(self, arguments: Mapping[str, Any]) -> Any:
        """Let the other tool validate."""
        return self.tool.validate(arguments)

    def parse(self, action: str, *, fences: bool = True) -> ToolCall | None:
        """Let the other tool read."""
        return self.tool.parse(action, fences=fences)

    def schema(self) -> dict[str, Any]:
        """Return that of the other tool."""
        return self.tool.schema()

    def instructions(self) -> str:
        """Return those of the other tool, without fenced blocks where they are left to the task."""
        tool = self.tool
        if self.fences != tool.fences:
            tool = copy.copy(tool)
            tool.fences = self.fences
        return tool.instructions()

    def hints(self) -> str:
        """Return those of the other tool."""
        return self.tool.hints()


def as_result(outcome: Outcome) -> ToolResult:
    """Return what a call returned as a result."""
    return outcome if isinstance(outcome, ToolResult) else ToolResult(outcome)
