"""``AgentRequests``: asks plain and asynchronous agents for many slots and seats at once."""

from __future__ import annotations

import asyncio
import inspect
from collections import deque
from collections.abc import Awaitable, Callable, Iterable

from gem_core.background import background_loop, run_sync
from gem_core.errors import AgentError, EnvFaultError, RequestError
from gem_core.rollouts.agent import Agent, Context, is_asynchronous
from gem_core.rollouts.running import RunningEpisode
from gem_core.types import Observation, Response

Asked = tuple[RunningEpisode, str]
"""An episode, and the seat in it whose agent is asked."""

Reply = Response | RequestError | EnvFaultError
"""An answer, or the error of the server, or of the environment that should sample an action."""

_CANCEL_TIMEOUT_S = 5.0


class AgentRequests:
    """Asks agents for many slots and seats at once.

    A plain agent answers while it is asked. What an asynchronous one returns runs as a task on an event loop.

    Args:
        agents: Those who may be asked, as far as they are known.
        notify: Called, from any thread, when a reply has come.
        most: Questions that are open at once; further ones wait, and the first that waits is the first asked.
        loop: Where tasks run: the running loop of the caller; None for the library's own.
    """

    def __init__(
        self,
        agents: Iterable[Agent],
        notify: Callable[[], None],
        *,
        most: int | None = None,
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        self.asynchronous = all(map(is_asynchronous, agents))
        """Whether asking does not wait for the answer."""
        self._notify = notify
        self._most = most
        self._loop = loop
        self._waiting: deque[tuple[Asked, Agent, Observation, Context]] = deque()
        self._open: set[Asked] = set()
        self._tasks: dict[asyncio.Future[str], RunningEpisode] = {}  # used in the thread of the loop only
        self._ready: deque[tuple[Asked, Response | BaseException]] = deque()

    def ask(self, asked: Asked, agent: Agent, observation: Observation, context: Context) -> None:
        """Ask an agent, now or once fewer questions are open."""
        self._waiting.append((asked, agent, observation, context))
        self._ask_waiting()

    def forget(self, running: RunningEpisode) -> None:
        """Cancel the questions of an episode, and ask those that wait for their places."""
        self._waiting = deque(question for question in self._waiting if question[0][0] is not running)
        cancelled = {asked for asked in self._open if asked[0] is running}
        if cancelled:
            self._open = self._open - cancelled
            self._on_loop(self._cancel_questions_of, running)
        self._ask_waiting()

    def is_ready(self) -> bool:
        """Tell whether there is a reply."""
        return bool(self._ready)

    def replies(self) -> list[tuple[Asked, Reply]]:
        """Return the replies that are ready, each with what was asked, and start requests that waited for a free place.

        Raises:
            AgentError: The agent returned something else than text, or cancelled its own task.
        """
        replies: list[tuple[Asked, Reply]] = []
        while self._ready:
            asked, reply = self._ready.popleft()
            self._open.discard(asked)
            if not isinstance(reply, Reply):
                raise reply
            replies.append((asked, reply))
        self._ask_waiting()
        return replies

    def close(self) -> None:
        """Cancel the open questions, and wait in plain code until their tasks have ended."""
        self._waiting.clear()
        if self._open or self._tasks:
            run_sync(self._cancel())

    async def aclose(self) -> None:
        """``close`` on the loop of the caller."""
        self._waiting.clear()
        await self._cancel()

    def _ask_waiting(self) -> None:
        while self._waiting and (self._most is None or len(self._open) < self._most):
            asked, agent, observation, context = self._waiting.popleft()
            try:
                answer = agent(observation, context)
            except (RequestError, EnvFaultError) as error:
                self._ready.append((asked, error))
                continue
            if not inspect.isawaitable(answer):
                self._ready.append((asked, _response(answer)))
                continue
            self._open.add(asked)
            self._on_loop(self._start, asked, answer)

    def _on_loop(self, function: Callable[..., None], *args: object) -> None:
        if self._loop is None:
            background_loop().call_soon_threadsafe(function, *args)
        else:
            function(*args)

    def _start(self, asked: Asked, answer: Awaitable[str]) -> None:
        task = asyncio.ensure_future(answer)
        self._tasks[task] = asked[0]
        task.add_done_callback(lambda _: self._end(asked, task))

    def _cancel_questions_of(self, running: RunningEpisode) -> None:
        for task, asked_for in self._tasks.items():
            if asked_for is running:
                task.cancel()

    def _end(self, asked: Asked, task: asyncio.Future[str]) -> None:
        del self._tasks[task]
        reply: Response | BaseException
        if task.cancelled():
            reply = AgentError("the agent's coroutine was cancelled; an agent must not cancel its own task")
        else:
            reply = task.exception() or _response(task.result())
        if asked in self._open:  # nobody waits for it otherwise
            self._ready.append((asked, reply))
            self._notify()

    async def _cancel(self) -> None:
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            # A coroutine that swallows its cancellation must not block the end of the run.
            await asyncio.wait(self._tasks, timeout=_CANCEL_TIMEOUT_S)


def _response(answer: object) -> Response | AgentError:
    if isinstance(answer, str):
        return Response.of(answer)
    return AgentError(f"an agent returns a str or a Response, and this one returned {type(answer).__name__}")
