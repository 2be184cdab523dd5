"""Environments in this process: in place, in a pool of threads, or as tasks on the library's event loop."""

from __future__ import annotations

import asyncio
import functools
import threading
import time
from collections.abc import Callable, Collection, MutableMapping
from typing import Any, cast

from gem_core.background import (
    DaemonPool,
    background_loop,
    finish_or_start,
    on_background_loop,
    wait_for_started,
)
from gem_core.errors import ArgumentError, FaultBudgetError
from gem_core.types import Concurrency
from gem_core.vector.body import Body, EnvFactory
from gem_core.vector.commands import Command, Failure, Outcome, Reset
from gem_core.vector.host import Host, Launch, free

MOST_ABANDONED = 64
"""Threads that hang at once before a run is stopped."""

_NONE = "\0none"
"""In the place of an id: there is no environment."""

_CLOSING_S = 5.0
"""How long ``close`` waits for tasks and threads to let go of what they hold."""


class LocalHost(Host):
    """Runs each environment of this process as its ``concurrency`` asks for.

    Args:
        factories: What makes the environment of each slot.
        concurrent: Whether threads and tasks are used at all; without, everything is done in place.
        kinds: What environments of an id need, where that is known before one is made.
        step_timeout: Seconds that a command may take; see ``make_vec``.
        started: Where it notes since when a slot's command runs.
        in_place: Kinds that are run in place, one after another.
    """

    def __init__(
        self,
        factories: list[EnvFactory],
        *,
        concurrent: bool = True,
        kinds: Callable[[str | None], Concurrency | None] = lambda env_id: None,
        step_timeout: float | None = None,
        started: MutableMapping[int, float] | None = None,
        in_place: Collection[Concurrency] = frozenset[Concurrency](["inline"]),
    ) -> None:
        self._quick = frozenset(in_place)
        self._factories = factories
        self._bodies = [Body(index, factory) for index, factory in enumerate(factories)]
        self._concurrent = concurrent
        self._kinds = kinds
        self._step_timeout = step_timeout
        self._pool = DaemonPool("gem-env")
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._started: MutableMapping[int, float] = {} if started is None else started
        self._lock = threading.RLock()
        # Under the lock, so that a thread knows whether what it ran is its own to close.
        self._left: set[Body] = set()
        """What was left to threads that have not come back."""
        self._closing: set[threading.Event] = set()
        """Set when what a slot gave back has been closed, which takes place in a thread."""

    def body(self, slot: int) -> Body:
        """Return the environment of a slot in its place."""
        return self._bodies[slot]

    def in_place(self, slot: int, command: Command) -> Body | None:
        """Return the slot's body if its environment is ``inline``; see ``Host.in_place``."""
        body = self._bodies[slot]
        if not self._concurrent:
            return body
        if self._step_timeout is not None:
            return None
        if isinstance(command, Reset) and (command.env_id != self._id_of(body)) and self._is_inline(command.env_id):
            # To make it takes little. A wrapper may need more than the task does, which shows only then.
            failed = body.prepare(command.env_id, command.kwargs)
            return body if failed or body.kind in self._quick else None
        return body if body.kind in self._quick else None

    def start(self, batch: list[Launch]) -> None:
        """Begin each command in a thread or as a task."""
        on_loop: list[Launch] = []
        for launch in batch:
            slot, _, command = launch
            body = self._bodies[slot]
            fits = not isinstance(command, Reset) or command.env_id == self._id_of(body)
            if body.kind == "async" and fits:
                on_loop.append(launch)
            else:
                self._pool.submit(functools.partial(self._in_thread, body, launch))
        if on_loop:
            background_loop().call_soon_threadsafe(self._spawn, on_loop)

    def ask(self, slot: int, question: str, *args: Any) -> Any:
        """Answer a question; see ``Host.ask``."""
        return answer(self._bodies[slot], question, *args)

    def release(self, slot: int) -> None:
        """Close a slot's environment."""
        body = self._bodies[slot]
        if not self._concurrent or body.kind is None or body.kind in self._quick:
            body.discard()
        else:
            # In the place of this one, since the slot may be asked for an episode before it is closed.
            self._bodies[slot] = Body(slot, self._factories[slot])
            closed = threading.Event()
            self._closing.add(closed)
            self._pool.submit(functools.partial(self._discard, body, closed))

    def _discard(self, body: Body, closed: threading.Event) -> None:
        try:
            body.discard()
        finally:
            self._closing.discard(closed)
            closed.set()

    def overdue(self, now: float) -> list[int]:
        """Return the slots whose command takes too long."""
        limit = self._step_timeout
        if limit is None:
            return []
        return [slot for slot, started in list(self._started.items()) if now - started >= limit]

    def next_check(self, now: float) -> float | None:
        """Return in how many seconds the first command that runs is overdue."""
        limit = self._step_timeout
        if limit is None:
            return None
        oldest = min(list(self._started.values()), default=now)
        return max(0.0, oldest + limit - now)

    def timed_out(self, slot: int) -> Failure:
        """Return what is said of a command that took too long."""
        return timeout_of(self._step_timeout)

    def abandon(self, slot: int, failure: Failure) -> Failure:
        """Leave the environment to the thread that hangs in it; cancel a task."""
        task = self._tasks.pop(slot, None)
        with self._lock:
            body, running = self._bodies[slot], self._started.pop(slot, None) is not None
            self._bodies[slot] = Body(slot, self._factories[slot])
            in_task = task is not None and not task.done()
            if running and not in_task:
                self._left.add(body)
        if in_task or not running:
            if task is not None:
                background_loop().call_soon_threadsafe(task.cancel)
            self._pool.submit(body.discard)
            return failure
        if self.hanging > MOST_ABANDONED:
            raise FaultBudgetError(
                f"{self.hanging} environments hang in threads that cannot be ended; the last: {failure.message}. "
                "Use backend='process', whose workers can be killed"
            )
        return failure

    @property
    def hanging(self) -> int:
        """Number of threads that were abandoned and have not come back."""
        return len(self._left)

    def close(self) -> None:
        """Close every environment; what hangs is left to its thread."""
        tasks = {slot: task for slot, task in self._tasks.items() if not task.done()}
        self._tasks = {}
        with self._lock:
            bodies = list(self._bodies)
            busy = {bodies[slot] for slot in self._started if slot not in tasks}
            self._left |= busy
            for body in busy:
                self._bodies[body.index] = Body(body.index, self._factories[body.index])
            self._started.clear()
        if tasks:
            finish_or_start(_cancelled(list(tasks.values())))
        for body in bodies:
            if body not in busy:
                body.discard()
        deadline = time.monotonic() + _CLOSING_S
        for closed in [] if on_background_loop() else list(self._closing):
            closed.wait(max(0.0, deadline - time.monotonic()))
        # An environment that failed in a task was closed there, and its tools' sessions may still be closing.
        wait_for_started(max(0.0, deadline - time.monotonic()))
        self._pool.close()

    def renewed(self) -> LocalHost:
        """Return a host without environments; see ``Host.renewed``."""
        free(self._lock)
        return LocalHost(
            self._factories,
            concurrent=self._concurrent,
            kinds=self._kinds,
            step_timeout=self._step_timeout,
            in_place=self._quick,
        )

    def _is_inline(self, env_id: str | None) -> bool:
        return self._kinds(env_id) in self._quick

    def _id_of(self, body: Body) -> str | None:
        return body.made_for[0] if body.made_for is not None else _NONE

    def _in_thread(self, body: Body, launch: Launch | None) -> None:
        slot = body.index
        while launch is not None:
            slot, ticket, command = launch
            self._started[slot] = time.monotonic()
            if not self.engine.is_current(slot, ticket):
                self._started.pop(slot, None)
                break
            outcome: Outcome | None = self._prepared(body, command)
            if outcome is None:
                if body.kind == "async":
                    # Known only now: it goes on where its coroutines run.
                    self._started.pop(slot, None)
                    background_loop().call_soon_threadsafe(self._spawn, [launch])
                    return
                outcome = body.perform(command)
            launch = self._advance(body, slot, ticket, outcome)
        self._came_back(body)

    def _spawn(self, batch: list[Launch]) -> None:
        loop = asyncio.get_running_loop()
        for launch in batch:
            slot = launch[0]
            self._tasks[slot] = loop.create_task(self._as_task(self._bodies[slot], launch))

    async def _as_task(self, body: Body, launch: Launch | None) -> None:
        while launch is not None:
            slot, ticket, command = launch
            self._started[slot] = time.monotonic()
            outcome = await body.perform_async(command)
            if self._bodies[slot] is not body:
                return  # abandoned in the meantime
            launch = self._advance(body, slot, ticket, outcome)

    def _prepared(self, body: Body, command: Command) -> Failure | None:
        if not isinstance(command, Reset):
            return None
        failure = body.prepare(command.env_id, command.kwargs)
        if failure is None and self._step_timeout is not None and body.kind == "inline":
            error = timeout_refused(command.env_id)
            failure = Failure("exception", str(error), error, hopeless=True)
        return failure

    def _advance(self, body: Body, slot: int, ticket: int, outcome: Outcome) -> Launch | None:
        with self._lock:
            if self._bodies[slot] is body:
                self._started.pop(slot, None)
        return self.engine.advance(self, slot, ticket, outcome)

    def _came_back(self, body: Body) -> None:
        """Close the environment of a thread that was abandoned, or whose vector environment was closed."""
        with self._lock:
            left = body in self._left
            self._left.discard(body)
        if left:
            body.discard()


def timeout_refused(env_id: str | None) -> ArgumentError:
    """Return the error of a ``step_timeout`` for an environment that runs in place, where nothing could keep it."""
    return ArgumentError(
        f"step_timeout cannot be kept for {env_id!r}, which runs in place; use backend='auto' or 'process', whose "
        "workers can be killed"
    )


def timeout_of(step_timeout: float | None) -> Failure:
    """Return what is said of a command that took longer than ``step_timeout``."""
    return Failure("timeout", f"a step or reset took longer than step_timeout, {step_timeout:g} s")


def answer(body: Body, question: str, *args: Any) -> Any:
    """Answer a question about an environment that is in this process; see ``Host.ask``."""
    if question == "sample":
        return body.sample_random_action(args[0])
    if question == "describe":
        return _described(body.env)
    env_id, kwargs = args
    failure = body.prepare(env_id, kwargs)
    if failure is not None:
        raise cast("BaseException", failure.error)
    task = cast("Any", body.env).unwrapped
    if question == "endless_tasks":
        return getattr(task, "endless_tasks", False) is True
    count = getattr(task, "num_tasks", None)
    return count if isinstance(count, int) else None


def _described(env: Any) -> dict[str, Any]:
    spec = None if env is None else env.spec
    if spec is None:
        return {"id": None if env is None else type(env.unwrapped).__name__, "kwargs": {}, "wrappers": []}
    return {"id": spec.id, "kwargs": spec.overrides(), "wrappers": wrappers_of(env)}


def wrappers_of(env: Any) -> list[Any]:
    """Return names and options of an environment's wrappers, innermost first."""
    spec = None if env is None else env.spec
    return [] if spec is None else [list(wrapper) for wrapper in spec.wrappers]


async def _cancelled(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    # A coroutine that swallows its cancellation must not hold up the end of the run.
    await asyncio.wait(tasks, timeout=_CLOSING_S)
