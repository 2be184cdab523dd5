"""Asking an agent for many slots at once, whether it is plain or asynchronous."""

from __future__ import annotations

import asyncio
import inspect
import queue
from collections.abc import Awaitable
from concurrent.futures import CancelledError, Future
from typing import Any

from gem_core.agents.base import Agent, Context
from gem_core.background import background_loop, run_sync
from gem_core.errors import AgentError, RequestError
from gem_core.types import Observation, Response

Outcome = Response | RequestError
"""What came of a question: an answer, or that the machinery behind the agent failed."""

_PATIENCE_S = 5.0


class Asking:
    """The questions of a run that are open.

    A plain agent answers while it is asked. The coroutines of an asynchronous one run on the library's loop, and its
    answers are taken as they come.

    Args:
        agent: Called with the observation and the context.
    """

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._ready: dict[int, Outcome] = {}
        self._open: dict[int, Future[Any]] = {}
        self._tasks: set[asyncio.Task[Any]] = set()
        self._done: queue.SimpleQueue[int] = queue.SimpleQueue()

    def ask(self, slot: int, observation: Observation, context: Context) -> None:
        """Ask for one slot.

        Raises:
            AgentError: The agent returned something else than text.
        """
        try:
            answer = self._agent(observation, context)
        except RequestError as error:
            self._ready[slot] = error
            return
        if not inspect.isawaitable(answer):
            self._ready[slot] = _checked(answer)
            return
        future = asyncio.run_coroutine_threadsafe(self._finish(answer), background_loop())
        self._open[slot] = future
        future.add_done_callback(lambda _: self._done.put(slot))

    def answers(self) -> dict[int, Outcome]:
        """Return the answers that are there, and wait for one if there is none.

        Raises:
            AgentError: The agent returned something else than text.
        """
        if self._open and not self._ready:
            self._take(self._done.get())
        while not self._done.empty():
            self._take(self._done.get())
        ready, self._ready = self._ready, {}
        return ready

    def close(self) -> None:
        """Cancel the questions that are open, and wait until they have let go of what they hold."""
        if self._open:
            self._open.clear()
            run_sync(self._cancel())

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
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        return await answer

    def _take(self, slot: int) -> None:
        future = self._open.pop(slot, None)
        if future is None:
            return
        try:
            self._ready[slot] = _checked(future.result())
        except RequestError as error:
            self._ready[slot] = error
        except CancelledError:
            raise AgentError("the agent's coroutine was cancelled; an agent must not cancel its own task") from None


def _checked(answer: object) -> Response:
    if not isinstance(answer, str):
        raise AgentError(f"an agent returns a str or a Response, and this one returned {type(answer).__name__}")
    return Response.of(answer)
