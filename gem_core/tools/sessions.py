"""Run the tools of an episode: open and close their sessions, and give up calls that take too long."""

from __future__ import annotations

import asyncio
import copy
import inspect
import logging
import weakref
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from gem_core.background import in_thread, run_or_schedule, run_without_loop, within
from gem_core.env.spaces import is_part
from gem_core.env.wrapper import most_demanding
from gem_core.tools.tool import Tool, ToolResult
from gem_core.types import Concurrency

T = TypeVar("T")

logger = logging.getLogger("gem_core")

MOST_LEFT_BEHIND = 64
"""Number of calls of one tool in this process that timed out and still run, at which no more are begun."""

_WAITED = "a plain tool waited for something; make its call() a coroutine function"

_abandoned_calls: Counter[tuple[type[Tool], str]] = Counter()
"""Number of such calls, by the tool's class and name. Global, since each holds a thread of the process for good."""


@dataclass
class _Attempt:
    """State of one call: its session, which belongs to the episode unless the call was abandoned."""

    session: Any = None
    opened: bool = False
    left_behind: bool = False


class ToolSessions:
    """The tools of an environment, and the sessions of its present episode.

    Args:
        tools: By name.
        timeout_s: Seconds that a call may take, with the opening of its session; None for no limit.
    """

    def __init__(self, tools: Mapping[str, Tool], timeout_s: float | None) -> None:
        self._tools = tools
        self.holders = {tool.session_key: tool for tool in reversed(list(tools.values()))}
        """The tools that close sessions, by the sessions' keys: of tools that share one, the first."""
        self.timeout_s = timeout_s
        self.concurrency: Concurrency = concurrency_of_tools(tools.values(), limited=timeout_s is not None)
        self.on_loop = self.concurrency == "async" or timeout_s is not None
        """Whether calls have to be awaited on the library's loop."""
        self.open: dict[str, Any] = {}
        """The open sessions, by their keys."""
        self.close = partial(_close_now, self.holders, self.open, self.on_loop, timeout_s)
        """Closes the open sessions, from plain code."""
        weakref.finalize(self, self.close)  # also when the interpreter exits

    def __deepcopy__(self, memo: dict[int, Any]) -> ToolSessions:
        copied = ToolSessions(copy.deepcopy(self._tools, memo), self.timeout_s)
        copied.open.update(copy.deepcopy(self.open, memo))
        return copied

    async def call(self, tool: Tool, arguments: Any) -> ToolResult:
        """Call a tool; an error becomes a failed result."""
        if self.timeout_s is None:
            return await self._attempt(tool, arguments, _Attempt())
        if (hanging := _abandoned_calls[type(tool), tool.name]) >= MOST_LEFT_BEHIND:
            return ToolResult(
                f"The tool failed: {hanging} earlier calls ran out of time and have not ended, so no more are begun.",
                failed=True,
            )
        attempt = _Attempt()
        running = asyncio.ensure_future(self._attempt(tool, arguments, attempt))
        try:
            done, _ = await asyncio.wait({running}, timeout=self.timeout_s)
        except asyncio.CancelledError:
            running.cancel()
            raise
        if done:
            return running.result()
        self._abandon(tool, attempt, running)
        lost = " What it remembered of this episode is lost." if attempt.opened and attempt.session is not None else ""
        return ToolResult(
            f"The tool did not answer within {self.timeout_s:g} s, and the call was given up.{lost}",
            failed=True,
            info={"timed_out": True},
        )

    async def _attempt(self, tool: Tool, arguments: Any, attempt: _Attempt) -> ToolResult:
        try:
            if tool.session_key in self.open:
                attempt.session, attempt.opened = self.open[tool.session_key], True
            else:
                attempt.session, attempt.opened = await self._run(tool, tool.open), True
                if not attempt.left_behind:
                    self.open[tool.session_key] = attempt.session
            return _as_result(tool, await self._run(tool, tool.call, arguments, attempt.session))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a failing tool is an observation for the agent
            message = f"{type(error).__name__}: {error}".strip()[:2000]
            return ToolResult(f"The tool failed: {message}", failed=True)

    def _abandon(self, tool: Tool, attempt: _Attempt, running: asyncio.Task[ToolResult]) -> None:
        """Abandon a call. Its session leaves the episode, and is closed when the call ends, if it ever does."""
        attempt.left_behind = True
        self.open.pop(tool.session_key, None)
        _abandoned_calls[type(tool), tool.name] += 1

        def tidy(_: asyncio.Task[ToolResult]) -> None:
            _abandoned_calls[type(tool), tool.name] -= 1
            if attempt.opened:
                run_or_schedule(_close_all({tool.name: tool}, {tool.name: attempt.session}, self.timeout_s))

        running.add_done_callback(tidy)
        if inspect.iscoroutinefunction(tool.call):
            running.cancel()  # what runs in a thread cannot be stopped: its task goes on until the thread ends

    async def _run(self, tool: Tool, method: Callable[..., Any], *args: Any) -> Any:
        return await _run(tool, self.timeout_s is not None, method, *args)

    def take(self) -> Coroutine[Any, Any, None] | None:
        """Return a coroutine that closes the open sessions, which are no longer this episode's; None without any."""
        taken = dict(self.open)
        self.open.clear()
        return _close_all(self.holders, taken, self.timeout_s) if taken else None

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


def _as_result(tool: Tool, outcome: Any) -> ToolResult:
    result = outcome if isinstance(outcome, ToolResult) else ToolResult(outcome)
    content = result.content
    if isinstance(content, str) or (isinstance(content, list) and all(map(is_part, content))):
        return result
    raise TypeError(f"{tool.name} returned {type(content).__name__}, not text, content parts or a ToolResult of them")


async def _run(tool: Tool, limited: bool, method: Callable[..., Any], *args: Any) -> Any:
    """Run a method of a tool; one that blocks, or that could not be given up otherwise, in a thread."""
    blocks = limited or tool.concurrency != "inline"
    if blocks and not any(map(inspect.iscoroutinefunction, (tool.call, method))):
        value = await in_thread(method, *args)
    else:
        value = method(*args)
    return await value if inspect.isawaitable(value) else value


async def _close_all(tools: Mapping[str, Tool], sessions: Mapping[str, Any], timeout_s: float | None) -> None:
    for name, session in sessions.items():
        closing = _run(tools[name], timeout_s is not None, tools[name].close, session)
        try:
            await (closing if timeout_s is None else within(timeout_s, closing))
        except (Exception, SystemExit):
            logger.warning("gem: closing the session of tool %r failed", name, exc_info=True)


def _close_now(tools: Mapping[str, Tool], sessions: dict[str, Any], on_loop: bool, timeout_s: float | None) -> None:
    taken = dict(sessions)
    sessions.clear()
    if taken and on_loop:
        run_or_schedule(_close_all(tools, taken, timeout_s))
    elif taken:
        run_without_loop(_close_all(tools, taken, timeout_s), _WAITED)
