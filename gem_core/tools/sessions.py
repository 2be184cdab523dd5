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
from typing import Any, TypeVar, cast

from gem_core.background import in_thread, run_or_schedule, run_without_loop
from gem_core.env.spaces import is_part
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
        # Also runs when the environment is collected and when the interpreter exits.
        self._finalizer = weakref.finalize(self, _close_now, self.holders, self.open, self.on_loop, timeout_s)

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
                run_or_schedule(_close_all({tool.name: tool}, {tool.name: attempt.session}, True, self.timeout_s))

        running.add_done_callback(tidy)
        if inspect.iscoroutinefunction(tool.call):
            running.cancel()  # what runs in a thread cannot be stopped: its task goes on until the thread ends

    async def _run(self, tool: Tool, method: Callable[..., Any], *args: Any) -> Any:
        return await _run(self.on_loop, self.timeout_s is not None, tool, method, *args)

    def take(self) -> dict[str, Any]:
        """Return the open sessions, which are no longer this episode's."""
        taken = dict(self.open)
        self.open.clear()
        return taken

    async def close_all(self, sessions: Mapping[str, Any]) -> None:
        """Close sessions that were taken."""
        await _close_all(self.holders, sessions, self.on_loop, self.timeout_s)

    def close(self) -> None:
        """Close the open sessions, from plain code."""
        _close_now(self.holders, self.open, self.on_loop, self.timeout_s)

    def finished(self, coroutine: Coroutine[Any, Any, T]) -> T | Coroutine[Any, Any, T]:
        """Return what a coroutine of this class returns, or the coroutine where it has to be awaited."""
        return coroutine if self.on_loop else run_without_loop(coroutine, _WAITED)


def concurrency_of_tools(tools: Iterable[Tool], *, limited: bool = False) -> Concurrency:
    """Return the concurrency that a set of tools requires."""
    wanted = {"async" if _has_coroutines(tool) else tool.concurrency for tool in tools}
    if limited:
        wanted.add("async")
    for need in ("process", "async", "thread"):
        if need in wanted:
            return cast("Concurrency", need)
    return "inline"


def _has_coroutines(tool: Tool) -> bool:
    return any(map(inspect.iscoroutinefunction, (tool.call, tool.open, tool.close)))


def _as_result(tool: Tool, outcome: Any) -> ToolResult:
    result = outcome if isinstance(outcome, ToolResult) else ToolResult(outcome)
    content = result.content
    if isinstance(content, str) or (isinstance(content, list) and all(map(is_part, content))):
        return result
    raise TypeError(f"{tool.name} returned {type(content).__name__}, not text, content parts or a ToolResult of them")


async def _run(on_loop: bool, limited: bool, tool: Tool, method: Callable[..., Any], *args: Any) -> Any:
    """Run a method of a tool; on the loop, that of a tool that blocks, or that could not be given up, in a thread."""
    blocks = (limited or tool.concurrency != "inline") and not inspect.iscoroutinefunction(tool.call)
    if on_loop and blocks and not inspect.iscoroutinefunction(method):
        return await _await_if_needed(await in_thread(method, *args))
    return await _await_if_needed(method(*args))


async def _await_if_needed(value: Any) -> Any:
    return await value if inspect.isawaitable(value) else value


async def _close_all(
    tools: Mapping[str, Tool], sessions: Mapping[str, Any], on_loop: bool, timeout_s: float | None
) -> None:
    for name, session in sessions.items():
        closing = _close_one(tools[name], session, on_loop, timeout_s is not None)
        if timeout_s is None:
            await closing
            continue
        running = asyncio.ensure_future(closing)
        await asyncio.wait({running}, timeout=timeout_s)
        if not running.done():
            running.cancel()
            logger.warning("gem: closing the session of tool %r took more than %g s", name, timeout_s)


async def _close_one(tool: Tool, session: Any, on_loop: bool, limited: bool) -> None:
    try:
        await _run(on_loop, limited, tool, tool.close, session)
    except (Exception, SystemExit):
        logger.warning("gem: closing the session of tool %r failed", tool.name, exc_info=True)


def _close_now(tools: Mapping[str, Tool], sessions: dict[str, Any], on_loop: bool, timeout_s: float | None) -> None:
    taken = dict(sessions)
    sessions.clear()
    if taken:
        closing = _close_all(tools, taken, on_loop, timeout_s)
        if on_loop:
            run_or_schedule(closing)
        else:
            run_without_loop(closing, _WAITED)
