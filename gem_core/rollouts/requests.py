"""AgentRequests an agent for many slots at once, whether it is plain or asynchronous."""

from __future__ import annotations

import asyncio
import inspect
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import CancelledError, Future
from typing import Any

from gem_core.background import background_loop, run_sync
from gem_core.errors import AgentError, EnvFaultError, RequestError
from gem_core.rollouts.agent import Agent, Context
from gem_core.types import Observation, Response

Outcome = Response | RequestError | EnvFaultError
"""What came of a question: an answer, or that the machinery behind the agent failed."""

_PATIENCE_S = 5.0

_Question = tuple[int, Observation, Context]


def is_asynchronous(agent: Agent) -> bool:
    """Tell whether an agent is known to answer later, as a coroutine function does."""
    call = getattr(agent, "function", agent)
    return inspect.iscoroutinefunction(call) or inspect.iscoroutinefunction(
        getattr(call, "__call__", None)  # noqa: B004 - it is looked at, not called
    )


class AgentRequests:
    """The questions of a run that are open.

    A plain agent answers while it is asked. The coroutines of an asynchronous one run as tasks, and its answers are
    taken as they come.

    Args:
        agent: Called with the observation and the context.
        notify: Called, from any thread, when an answer has come.
        most: Questions that are open at once; further ones wait, and the first that waits is the first asked.
        loop: Where coroutines run; None for the library's own loop.
    """

    def __init__(
        self,
        agent: Agent,
        notify: Callable[[], None],
        *,
        most: int | None = None,
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        self.asynchronous = is_asynchronous(agent)
        """Whether it is known to answer later."""
        self._agent = agent
        self._notify = notify
        self._most = most
        self._loop = loop
        self._ready: dict[int, Outcome] = {}
        self._open: dict[int, Future[Any] | asyncio.Task[Any]] = {}
        self._waiting: deque[_Question] = deque()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._done: deque[int] = deque()

    def ask(self, slot: int, observation: Observation, context: Context) -> None:
        """Ask for one slot.

        Raises:
            AgentError: The agent returned something else than text.
        """
        self._waiting.append((slot, observation, context))
        self._ask_waiting()

    def is_ready(self) -> bool:
        """Tell whether there is an answer."""
        return bool(self._ready or self._done)

    def answers(self) -> dict[int, Outcome]:
        """Return the answers that are there.

        Raises:
            AgentError: The agent returned something else than text.
        """
        while self._done:
            self._take(self._done.popleft())
        self._ask_waiting()
        ready, self._ready = self._ready, {}
        return ready

    def close(self) -> None:
        """Cancel the questions that are open, and wait in plain code until they have let go of what they hold."""
        self._waiting.clear()
        if self._open:
            self._open.clear()
            run_sync(self._cancel())

    async def aclose(self) -> None:
        """``close`` for the loop that the questions run on."""
        self._waiting.clear()
        self._open.clear()
        await self._cancel()

    def _ask_waiting(self) -> None:
        while self._waiting and (self._most is None or len(self._open) < self._most):
            slot, observation, context = self._waiting.popleft()
            try:
                answer = self._agent(observation, context)
            except (RequestError, EnvFaultError) as error:
                self._ready[slot] = error
                continue
            if inspect.isawaitable(answer):
                self._start(slot, answer)
            else:
                self._ready[slot] = _checked(answer)

    def _start(self, slot: int, answer: Awaitable[str]) -> None:
        future: Future[Any] | asyncio.Task[Any]
        if self._loop is not None:
            # The coroutine itself: one around it that is cancelled before it begins would leave it unawaited.
            future = asyncio.ensure_future(answer, loop=self._loop)
            self._note(future)
        else:
            future = asyncio.run_coroutine_threadsafe(self._finish(answer), background_loop())
        self._open[slot] = future
        future.add_done_callback(lambda _: self._came(slot))

    def _came(self, slot: int) -> None:
        self._done.append(slot)
        self._notify()

    async def _cancel(self) -> None:
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            # A coroutine that swallows its cancellation must not hold up the end of the run.
            await asyncio.wait(tasks, timeout=_PATIENCE_S)

    async def _finish(self, answer: Awaitable[str]) -> str:
        task = asyncio.current_task()
        if task is not None:
            self._note(task)
        return await answer

    def _note(self, task: asyncio.Task[Any]) -> None:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(_seen)

    def _take(self, slot: int) -> None:
        future = self._open.pop(slot, None)
        if future is None:
            return
        try:
            self._ready[slot] = _checked(future.result())
        except (RequestError, EnvFaultError) as error:
            self._ready[slot] = error
        except (CancelledError, asyncio.CancelledError):
            raise AgentError("the agent's coroutine was cancelled; an agent must not cancel its own task") from None


def _seen(task: asyncio.Task[Any]) -> None:
    """Look at what a task raised, or asyncio would complain where the run ends before it is taken."""
    if not task.cancelled():
        task.exception()


def _checked(answer: object) -> Response:
    if not isinstance(answer, str):
        raise AgentError(f"an agent returns a str or a Response, and this one returned {type(answer).__name__}")
    return Response.of(answer)
