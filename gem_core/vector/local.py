"""Executors for environments in this process: in place, in a pool of threads, or as tasks on the event loop."""

from __future__ import annotations

import asyncio
import functools
import threading
import time
from collections.abc import Collection

from gem_core.background import DaemonPool, background_loop, finish_or_start, on_background_loop, wait_for_started
from gem_core.errors import FaultBudgetError
from gem_core.types import Concurrency
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Reset
from gem_core.vector.executor import CommandTimes, Executor, Launch, free
from gem_core.vector.runner import EnvRunner
from gem_core.vector.setup import VectorSetup

MOST_ABANDONED = 64
"""Number of hanging threads at which a run is stopped."""

_CLOSING_S = 5.0
"""Seconds that ``close`` waits for tasks and threads that close environments."""


class LocalExecutor(Executor):
    """Runs each environment in this process, as its ``concurrency`` requires.

    Args:
        setup: What environments are made from.
        in_place: Values of ``concurrency`` whose commands the caller runs at once, one after another.
        times: Where the start times of commands are recorded.
    """

    def __init__(
        self,
        setup: VectorSetup,
        *,
        in_place: Collection[Concurrency] = frozenset[Concurrency](["inline"]),
        times: CommandTimes | None = None,
    ) -> None:
        self._setup = setup
        self._in_place = frozenset(in_place)
        self._factories = setup.factories()
        self.runners: list[EnvRunner] = [EnvRunner(slot, factory) for slot, factory in enumerate(self._factories)]
        self._times = CommandTimes(len(self.runners)) if times is None else times
        self._pool = DaemonPool("gem-env")
        # The lock protects the replacement of runners, so that a thread knows whether to close the one that it ran.
        self._lock = threading.RLock()
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._hanging: set[EnvRunner] = set()
        """Abandoned runners whose threads still hang."""
        self._closing: set[threading.Event] = set()
        """Events, each set once a thread has closed an environment."""
        self._closed = False

    def in_place(self, slot: int, command: Command) -> EnvRunner | None:
        """Return the slot's runner if its environment runs in place; a ``Reset`` of another id may make one here."""
        runner = self.runners[slot]
        reset = command.reset if isinstance(command, Rebuild) else command
        if (
            isinstance(reset, Reset)
            and not runner.has_env_for(reset.env_id)
            and self._setup.task_concurrency(reset.env_id) in self._in_place
        ):
            # Making it is cheap. A wrapper may need more than the task does, which is known only afterwards.
            failed = runner.prepare(reset.env_id, reset.kwargs)
            return runner if failed or runner.concurrency in self._in_place else None
        return runner if runner.concurrency in self._in_place else None

    def start(self, batch: list[Launch]) -> None:
        """Begin each command in a thread or as a task."""
        tasks: list[tuple[EnvRunner, Launch]] = []
        with self._lock:
            if self._closed:
                return
            for launch in batch:
                slot, _, command = launch
                runner = self.runners[slot]
                if runner.concurrency == "async" and (not isinstance(command, Reset) or runner.has_env_for(command[0])):
                    tasks.append((runner, launch))
                else:
                    self._pool.submit(functools.partial(self._run_in_thread, runner, launch))
        if tasks:
            background_loop().call_soon_threadsafe(self._run_as_tasks, tasks)

    def release(self, slot: int) -> None:
        """Close a slot's environment."""
        runner = self.runners[slot]
        if runner.concurrency is None or runner.concurrency in self._in_place:
            runner.discard()
        else:
            self._discard_in_thread(self._replace(slot))

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs in a thread or a task, and since when."""
        return self._times.running()

    def abandon(self, slot: int, failure: Failure) -> None:
        """Cancel the task of a slot, or abandon the thread that hangs and replace the slot's runner.

        Raises:
            FaultBudgetError: Too many threads hang.
        """
        with self._lock:
            task, busy = self._tasks.pop(slot, None), slot in self._times.running()
            runner = self._replace(slot)
            if task is None and busy:
                self._hanging.add(runner)
        if task is not None:
            background_loop().call_soon_threadsafe(task.cancel)
        if task is not None or not busy:
            self._discard_in_thread(runner)
        elif len(self._hanging) > MOST_ABANDONED:
            raise FaultBudgetError(
                f"{len(self._hanging)} environments hang in threads that cannot be ended; the last: {failure.message}. "
                "Use backend='process', whose workers can be killed"
            )

    def close(self) -> None:
        """Close every environment, except those in which a thread hangs."""
        with self._lock:
            self._closed = True
            tasks, self._tasks = self._tasks, {}
            busy = self._times.running().keys() - tasks.keys()
            runners = [self._replace(slot) for slot in range(len(self.runners))]
            self._hanging |= {runners[slot] for slot in busy}
        if tasks:
            finish_or_start(_cancel_tasks(list(tasks.values())))
        for slot, runner in enumerate(runners):
            if slot not in busy:
                runner.discard()
        deadline = time.monotonic() + _CLOSING_S
        for closed in [] if on_background_loop() else list(self._closing):
            closed.wait(max(0.0, deadline - time.monotonic()))
        # An environment that failed in a task was closed there, but its tools' sessions may still be closing.
        wait_for_started(max(0.0, deadline - time.monotonic()))
        self._pool.close()

    def renewed(self) -> LocalExecutor:
        """Return an executor without environments; see ``Executor.renewed``."""
        free(self._lock)
        return LocalExecutor(self._setup, in_place=self._in_place)

    def _replace(self, slot: int) -> EnvRunner:
        """Give a slot a new runner and return the old one, which may be closed after the slot is used again."""
        with self._lock:
            runner, self.runners[slot] = self.runners[slot], EnvRunner(slot, self._factories[slot])
            self._times.end(slot)
            return runner

    def _discard_in_thread(self, runner: EnvRunner) -> None:
        closed = threading.Event()
        self._closing.add(closed)

        def discard() -> None:
            try:
                runner.discard()
            finally:
                self._closing.discard(closed)
                closed.set()

        self._pool.submit(discard)

    def _run_in_thread(self, runner: EnvRunner, launch: Launch) -> None:
        slot, ticket, command = launch
        if self.runners[slot] is not runner:
            return
        self._times.begin(slot)
        outcome: Outcome | None = None
        if isinstance(command, Reset):
            outcome = runner.prepare(command.env_id, command.kwargs)
            if outcome is None and runner.concurrency == "async":
                # Its concurrency is known only now that it was made: continue on the event loop.
                background_loop().call_soon_threadsafe(self._run_as_tasks, [(runner, launch)])
                return
        self._finish(runner, ticket, runner.perform(command) if outcome is None else outcome)

    def _run_as_tasks(self, launches: list[tuple[EnvRunner, Launch]]) -> None:
        loop = asyncio.get_running_loop()
        for runner, launch in launches:
            slot = launch[0]
            with self._lock:
                if self.runners[slot] is runner:
                    self._times.begin(slot)
                    self._tasks[slot] = loop.create_task(self._run_as_task(runner, launch))
                else:
                    self._hanging.discard(runner)
                    self._discard_in_thread(runner)

    async def _run_as_task(self, runner: EnvRunner, launch: Launch) -> None:
        self._finish(runner, launch[1], await runner.perform_async(launch[2]))

    def _finish(self, runner: EnvRunner, ticket: int, outcome: Outcome) -> None:
        slot = runner.slot
        with self._lock:
            abandoned = self.runners[slot] is not runner
            self._hanging.discard(runner)
            if not abandoned:
                self._tasks.pop(slot, None)
                self._times.end(slot)
        if abandoned:
            runner.discard()
        else:
            self.scheduler.advance(slot, ticket, outcome)


class SyncExecutor(Executor):
    """Runs every environment in the calling thread, one after another.

    Args:
        setup: What environments are made from.
    """

    def __init__(self, setup: VectorSetup) -> None:
        self._setup = setup
        self.runners = [EnvRunner(slot, factory) for slot, factory in enumerate(setup.factories())]

    def in_place(self, slot: int, command: Command) -> EnvRunner:
        """Return the slot's runner."""
        return self.runners[slot]

    def start(self, batch: list[Launch]) -> None:
        """Do nothing; never called, since every command runs in place."""

    def close(self) -> None:
        """Close every environment."""
        for runner in self.runners:
            runner.discard()

    def renewed(self) -> SyncExecutor:
        """Return an executor without environments."""
        return SyncExecutor(self._setup)


async def _cancel_tasks(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    # A coroutine that swallows its cancellation must not block the end of the run.
    await asyncio.wait(tasks, timeout=_CLOSING_S)
