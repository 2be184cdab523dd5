"""Run the tools of an episode: open and close their sessions, and give up calls that take too long."""

from __future__ import annotations

import copy
import inspect
import logging
import weakref
from collections.abc import Callable, Coroutine, Iterable, Mapping
from functools import partial
from typing import Any, TypeVar

from gem_core.background import in_thread, run_or_schedule, run_without_loop, within
from gem_core.env.spaces import is_part
from gem_core.env.wrapper import most_demanding
from gem_core.tools.tool import Tool, ToolResult
from gem_core.types import Concurrency

T = TypeVar("T")

logger = logging.getLogger("gem_core")

_WAITED = "a plain tool waited for something; make its call() a coroutine function"


class ToolSessions:
    """The tools of an environment, and the sessions of its present episode.

    Args:
        tools: By name.
        timeout_s: Seconds that a call may take, with the opening of its session; None for no limit.
    """

    def __init__(self, tools: Mapping[str, Tool], timeout_s: float | None) -> None:
        self._tools = tools
        self.timeout_s = timeout_s
        self.concurrency: Concurrency = concurrency_of_tools(tools.values(), limited=timeout_s is not None)
        self.open: dict[str, Any] = {}
        """The open sessions, by their keys."""
        self._closers = {tool.session_key: tool for tool in reversed(list(tools.values()))}
        """The tools that close sessions, by the sessions' keys: of tools that share one, the first."""
        self.on_loop = self.concurrency == "async" or timeout_s is not None
        """Whether calls have to be awaited on the library's loop."""
        self.close = partial(_close_now, self._closers, self.open, self.on_loop, timeout_s)
        """Closes the open sessions, from plain code."""
        weakref.finalize(self, self.close)  # also when the interpreter exits

    def __deepcopy__(self, memo: dict[int, Any]) -> ToolSessions:
        copied = ToolSessions(copy.deepcopy(self._tools, memo), self.timeout_s)
        copied.open.update(copy.deepcopy(self.open, memo))
        return copied

    async def call(self, tool: Tool, arguments: Any) -> ToolResult:
        """Call a tool; an error becomes a failed result, and so does a call that takes too long."""
        calling = self._called(tool, arguments)
        if self.timeout_s is None:
            return await calling
        try:
            return await within(self.timeout_s, calling)
        except TimeoutError:
            lost = tool.session_key in self.open
            session = self.open.pop(tool.session_key, None)
            if lost:
                run_or_schedule(_close_all({"": tool}, {"": session}, self.timeout_s))
            forgotten = " What it remembered of this episode is lost." if session is not None else ""
            told = f"The tool did not answer within {self.timeout_s:g} s, and the call was given up.{forgotten}"
            return ToolResult(told, failed=True, info={"timed_out": True})

    async def _called(self, tool: Tool, arguments: Any) -> ToolResult:
        key, limited = tool.session_key, self.timeout_s is not None
        try:
            if key not in self.open:
                self.open[key] = await _run(tool, limited, tool.open)
            outcome = await _run(tool, limited, tool.call, arguments, self.open[key])
            result = outcome if isinstance(outcome, ToolResult) else ToolResult(outcome)
            content = result.content
            if isinstance(content, str) or (isinstance(content, list) and all(map(is_part, content))):
                return result
            raise TypeError(f"{tool.name} returned {type(content).__name__}, not text, content parts or a ToolResult")
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a failing tool is an observation for the agent
            message = f"{type(error).__name__}: {error}".strip()[:2000]
            return ToolResult(f"The tool failed: {message}", failed=True)

    def take(self) -> Coroutine[Any, Any, None] | None:
        """Return a coroutine that closes the open sessions, which are no longer this episode's; None without any."""
        return _taken(self._closers, self.open, self.timeout_s)

    def finished(self, coroutine: Coroutine[Any, Any, T]) -> T | Coroutine[Any, Any, T]:
        """Return the result of a coroutine of this class, or the coroutine if it has to be awaited."""
        return coroutine if self.on_loop else run_without_loop(coroutine, _WAITED)


def concurrency_of_tools(tools: Iterable[Tool], *, limited: bool = False) -> Concurrency:
    """Return the concurrency that a set of tools requires."""
    needs: list[Concurrency] = ["async"] if limited else []
    for tool in tools:
        methods = tool.call, tool.open, tool.close
        needs.append("async" if any(map(inspect.iscoroutinefunction, methods)) else tool.concurrency)
    return most_demanding("inline", *needs)


async def _run(tool: Tool, limited: bool, method: Callable[..., Any], *args: Any) -> Any:
    """Run a method of a tool; one that blocks, or that could not be given up otherwise, in a thread."""
    blocks = limited or tool.concurrency != "inline"
    if blocks and not any(map(inspect.iscoroutinefunction, (tool.call, method))):
        value = await in_thread(method, *args)
    else:
        value = method(*args)
    return await value if inspect.isawaitable(value) else value


async def _close_all(tools: Mapping[str, Tool], sessions: Mapping[str, Any], timeout_s: float | None) -> None:
    for key, session in sessions.items():
        closing = _run(tools[key], timeout_s is not None, tools[key].close, session)
        try:
            await (closing if timeout_s is None else within(timeout_s, closing))
        except (Exception, SystemExit):
            logger.warning("gem: closing the session of tool %r failed", tools[key].name, exc_info=True)


def _taken(
    tools: Mapping[str, Tool], sessions: dict[str, Any], timeout_s: float | None
) -> Coroutine[Any, Any, None] | None:
    taken = dict(sessions)
    sessions.clear()
    return _close_all(tools, taken, timeout_s) if taken else None


def _close_now(tools: Mapping[str, Tool], sessions: dict[str, Any], on_loop: bool, timeout_s: float | None) -> None:
    closing = _taken(tools, sessions, timeout_s)
    if closing is not None and on_loop:
        run_or_schedule(closing)
    elif closing is not None:
        run_without_loop(closing, _WAITED)
