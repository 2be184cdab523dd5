"""``RemoteExecutor``: runs environments in workers of any kind, which can be killed and replaced."""

from __future__ import annotations

import copy
import itertools
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.errors import ArgumentError, EnvFaultError, WorkerLostError
from gem_core.making.layers import wrapper_targets
from gem_core.registry.lookup import registry
from gem_core.types import Action, Observation
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Reset
from gem_core.vector.executor import Executor, Launch, free
from gem_core.vector.scheduler import Scheduler
from gem_core.vector.setup import VectorSetup
from gem_core.vector.workers.messages import WorkerMessage, from_bytes, to_bytes

_ATTEMPTS = 3
"""Number of workers that may die during a call before it is given up."""

_Failed = tuple[int, int, Failure]
"""Slot, ticket and failure of a command."""

_NOT_REPLAYED = "its worker was lost with another environment, and this episode cannot be replayed"


class Running(NamedTuple):
    """Commands that were running in a worker at a given time, by ``time.monotonic()`` in this process.

    Args:
        at: The time of the observation.
        since: The slots whose command was running, and since when.
    """

    at: float
    since: dict[int, float]


class WorkerLink(ABC):
    """The connection to a worker, in the program that uses it; the worker runs a ``Worker``.

    It calls ``received`` with the bytes that ``Worker.given`` yields, and ``died`` once, when no more will come; both
    from a thread that holds no reference to the link while it waits, so that it does not keep a vector environment
    alive.

    Args:
        executor: Executor that the worker belongs to.
    """

    def __init__(self, executor: RemoteExecutor) -> None:
        self._executor = weakref.ref(executor)

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Pass bytes to ``Worker.take``, in order, without waiting; do nothing if the worker is dead."""

    @abstractmethod
    def running(self) -> Running | None:
        """Return the commands that run, or ran when it died, from the worker's ``CommandTimes``; None if unknown."""

    @abstractmethod
    def death(self) -> str:
        """Return how it died, as part of a sentence."""

    @abstractmethod
    def kill(self) -> None:
        """Kill the worker, and all processes that it has started."""

    @abstractmethod
    def close(self) -> None:
        """Let the worker close its environments, then end it."""

    def received(self, data: bytes) -> None:
        """Handle bytes from the worker."""
        executor = self._executor()
        if executor is not None:
            executor.on_messages(self, from_bytes(data))

    def died(self, permanent: EnvFaultError | None = None) -> None:
        """Handle the end of the worker.

        Args:
            permanent: Why another worker could not be started either.
        """
        executor = self._executor()
        if executor is not None:
            executor.on_death(self, None if permanent is None else _permanent_failure(permanent))


@dataclass
class _SlotState:
    """State of a slot whose environment lives in a worker."""

    ticket: int = -1
    command: Command | None = None
    """The command under way."""
    sent_at: float = 0.0
    reset: Reset | None = None
    """Command that began the present episode."""
    actions: list[Action] | None = None
    """Actions stepped since then; None for an episode that cannot be replayed."""
    observation: Observation = ""
    is_lost: bool = False
    """Whether the environment was lost with its worker."""
    description: dict[str, Any] | None = None

    def rebuild(self, action: Action) -> Rebuild | None:
        """Return the command that rebuilds a lost environment and steps it; None if it cannot be replayed."""
        if self.reset is None or self.actions is None:
            return None
        return Rebuild(self.reset, self.actions, self.observation, action)

    def prepare(self) -> bool:
        """Adapt the command to a new worker if the environment is lost; return whether it can be run there."""
        command: Command | None = self.command.action if isinstance(self.command, Rebuild) else self.command
        if command is not None and not isinstance(command, Reset | Rebuild) and self.is_lost:
            command = self.rebuild(command)
        self.command, self.is_lost, self.sent_at = command, False, time.monotonic()
        return command is not None

    def finish(self, outcome: Outcome) -> None:
        """Record the outcome of the command under way, for a replay."""
        command, self.command = self.command, None
        if isinstance(outcome, Failure):
            return
        self.observation = outcome[0]
        if self.actions is not None and not isinstance(command, Reset):
            self.actions.append(command.action if isinstance(command, Rebuild) else cast("Action", command))


class RemoteExecutor(Executor, ABC):
    """Runs environments in workers, many in each, and replaces a worker that dies or has to be killed.

    The environments that ran when a worker died fail with ``kind="died"``. The others are rebuilt in the next worker:
    deterministic ones by replaying seed and actions; the rest fail with ``kind="collateral"``.

    A subclass implements how a worker is started.

    Args:
        setup: What environments are made from.
        workers: Number of workers; slots are assigned to them in turn.

    Raises:
        ArgumentError: The setup cannot be pickled.
    """

    scheduler: Scheduler

    def __init__(self, setup: VectorSetup, workers: int) -> None:
        self.setup = setup
        self.packed = _pack_setup(setup)
        """Pickled setup from which a ``Worker`` is made."""
        self._begin(workers)

    def _begin(self, workers: int) -> None:
        slots = len(self.setup.ids)
        self._worker_of = [slot % workers for slot in range(slots)]
        self._lock = threading.RLock()
        self._closed = False
        self._slots = [_SlotState() for _ in range(slots)]
        self.links: list[WorkerLink | None] = [None] * workers
        """The workers by number; None for one that has not been started, or is gone."""
        self._known_ids: list[set[str]] = [set() for _ in range(workers)]
        self._numbers = itertools.count()
        self._calls: dict[int, tuple[WorkerLink, list[Any]]] = {}
        """Calls without an answer yet: the worker, and the list that will hold the answer."""

    @abstractmethod
    def start_worker(self) -> WorkerLink:
        """Start a worker."""

    def start(self, batch: list[Launch]) -> None:
        """Send the commands to their workers, all commands of a worker together."""
        with self._lock:
            for slot, ticket, command in batch:
                state = self._slots[slot]
                state.ticket, state.command = ticket, command
                if isinstance(command, Reset):
                    deterministic = command.env_id is not None and self.setup.record(command.env_id).deterministic
                    state.reset, state.actions = command, [] if deterministic else None
            failures = self._send([slot for slot, _, _ in batch])
        self._fail(failures)

    def sample_random_action(self, slot: int, seed: int | None, agent: str | None = None) -> str:
        """Return a valid action; see ``Executor.sample_random_action``."""
        return cast("str", self._call(slot, "sample_random_action", seed, agent))

    def tasks(self, slot: int, env_id: str | None, kwargs: Mapping[str, Any]) -> tuple[int | None, bool]:
        """Return ``num_tasks`` and ``endless_tasks``; see ``Executor.tasks``."""
        return cast("tuple[int | None, bool]", self._call(slot, "tasks", env_id, kwargs, record_of=env_id))

    def apply(
        self, slot: int, env_id: str | None, kwargs: Mapping[str, Any], function: Callable[..., Any], *args: Any
    ) -> Any:
        """Return what a function of the environment returns, a copy from its worker; see ``Executor.apply``."""
        return self._call(slot, "apply", env_id, dict(kwargs), function, *args, record_of=env_id)

    def describe(self, slot: int) -> dict[str, Any]:
        """Return the description of a slot's environment that its worker sent when it was made."""
        return dict(self._slots[slot].description or {"id": None, "kwargs": {}, "wrappers": []})

    def release(self, slot: int) -> None:
        """Close a slot's environment, if its worker is running."""
        with self._lock:
            self._slots[slot] = _SlotState()
            link = self.links[self._worker_of[slot]]
            if link is not None:
                link.send(to_bytes([("release", slot)]))

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs, and since when."""
        found: dict[int, float] = {}
        for worker, link in enumerate(list(self.links)):
            if link is not None:
                found |= self._running_in(link, self._slots_of(worker))
        return found

    def abandon(self, slot: int, failure: Failure) -> None:
        """Kill the worker; its other slots go on in a new one."""
        with self._lock:
            worker = self._worker_of[slot]
            link = self.links[worker]
            if link is None:
                return
            self._forget(worker, link)
            link.kill()
            failures = self._mark_lost([slot], [other for other in self._slots_of(worker) if other != slot], failure)
        # The scheduler itself reports the failure of the slot.
        self._fail([each for each in failures if each[0] != slot])

    def close(self) -> None:
        """Close every environment, and end every worker."""
        with self._lock:
            self._closed = True
            links = [(worker, link) for worker, link in enumerate(self.links) if link is not None]
            for worker, link in links:
                self._forget(worker, link, EnvFaultError("the vector environment was closed before it answered"))
        threads = [threading.Thread(target=link.close, name="gem-close", daemon=True) for _, link in links]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def renewed(self) -> Self:
        """Return an executor without workers; see ``Executor.renewed``."""
        free(self._lock)
        other = copy.copy(self)
        other._begin(len(self.links))
        return other

    # Called by links, from their threads.

    def on_messages(self, link: WorkerLink, messages: list[WorkerMessage]) -> None:
        """Handle messages from a worker."""
        for message in messages:
            kind, *rest = message
            if kind == "done":
                self._on_done(*rest)
            elif kind == "answer":
                _, answer = self._calls.pop(rest[0], (None, []))
                answer.append(rest[1])
                self.scheduler.signal.set()
            elif kind == "made":
                self._slots[rest[0]].description = rest[1]
            elif kind == "broken":
                self.on_death(link, rest[0])

    def on_death(self, link: WorkerLink, permanent: Failure | None = None) -> None:
        """Fail the commands that ran in a worker that died, and continue its other slots in a new worker."""
        with self._lock:
            if link not in self.links:
                return  # closed or killed on purpose
            worker = self.links.index(link)
            slots = self._slots_of(worker)
            under_way = [slot for slot in slots if self._slots[slot].command is not None]
            ran = [slot for slot in self._running_in(link, slots) if slot in under_way]
            self._forget(worker, link)
            if permanent is not None:
                failures = self._mark_lost(under_way, [], permanent)
            else:
                among = "" if len(ran) < 2 else f", while it was one of {len(ran)} environments that ran in it"
                failure = Failure("died", f"its worker process {link.death()}{among}")
                failed = ran or under_way[:1]
                failures = self._mark_lost(failed, [slot for slot in slots if slot not in failed], failure)
        self._fail(failures)

    def _on_done(self, slot: int, ticket: int, outcome: Outcome) -> None:
        with self._lock:
            state = self._slots[slot]
            if state.ticket != ticket or state.command is None:
                return  # its worker has been killed in the meantime
            state.finish(outcome)
        self.scheduler.advance(slot, ticket, outcome)

    # Called with the lock held.

    def _mark_lost(self, failed: Collection[int], bystanders: Collection[int], failure: Failure) -> list[_Failed]:
        """Mark environments as lost; send the commands of the bystanders again, and return all failures."""
        for slot in (*failed, *bystanders):
            self._slots[slot].is_lost = True
        failures = [(slot, self._slots[slot].ticket, failure) for slot in failed]
        for slot in failed:
            self._slots[slot].command = None
        return failures + self._send([slot for slot in bystanders if self._slots[slot].command is not None])

    def _send(self, slots: list[int]) -> list[_Failed]:
        """Send the commands of slots, all commands of a worker together; return those that cannot be run."""
        failures: list[_Failed] = []
        by_worker: dict[int, list[int]] = {}
        for slot in [] if self._closed else slots:
            by_worker.setdefault(self._worker_of[slot], []).append(slot)
        for worker, group in by_worker.items():
            try:
                messages: list[WorkerMessage] = []
                link = self._link(worker)
                for slot in group:
                    state = self._slots[slot]
                    if not state.prepare():
                        failures.append((slot, state.ticket, Failure("collateral", _NOT_REPLAYED)))
                        continue
                    if isinstance(state.command, Reset):
                        messages += self._record_message(worker, state.command.env_id)
                    messages.append(("do", slot, state.ticket, state.command))
                link.send(to_bytes(messages))
            except Exception as error:  # noqa: BLE001 - reported to those that wait for the slots
                failures += [(slot, self._slots[slot].ticket, _permanent_failure(error)) for slot in group]
        return failures

    def _running_in(self, link: WorkerLink, slots: Collection[int]) -> dict[int, float]:
        """Return the slots of a worker whose command is running, and since when."""
        running = link.running()
        under_way = {slot: state.sent_at for slot in slots if (state := self._slots[slot]).command is not None}
        if running is None:
            # Unknown: assume that the oldest command without an outcome is running.
            return dict(sorted(under_way.items(), key=lambda each: each[1])[:1])
        # Skip slots whose present command was sent after the observation: it saw the command before.
        return {slot: since for slot, since in running.since.items() if under_way.get(slot, running.at) < running.at}

    def _link(self, worker: int) -> WorkerLink:
        link = self.links[worker]
        if link is None:
            if self._closed:
                raise EnvFaultError("the vector environment was closed before it answered")
            link = self.links[worker] = self.start_worker()
            self._known_ids[worker] = set(self.setup.all_ids)
        return link

    def _record_message(self, worker: int, env_id: str | None) -> list[WorkerMessage]:
        """Return a message with the record of an id that a worker does not know, as one that a script registered."""
        if env_id is None or env_id in self._known_ids[worker]:
            return []
        self._known_ids[worker].add(env_id)
        record = self.setup.record(env_id)
        return [("know", pack_by_value([record], [record.entry_point]))]

    def _forget(self, worker: int, link: WorkerLink, why: Exception | None = None) -> None:
        self.links[worker] = None
        for number, (asked, answer) in list(self._calls.items()):
            if asked is link:
                del self._calls[number]
                answer.append(why or WorkerLostError("the worker died before it answered"))
        self.scheduler.signal.set()

    # Called without the lock.

    def _fail(self, failures: list[_Failed]) -> None:
        for slot, ticket, failure in failures:
            self._slots[slot].command = None
            self.scheduler.advance(slot, ticket, failure)

    def _slots_of(self, worker: int) -> list[int]:
        return [slot for slot, own in enumerate(self._worker_of) if own == worker]

    def _call(self, slot: int, method: str, *args: Any, record_of: str | None = None) -> Any:
        """Call a method of the ``LocalExecutor`` in a slot's worker; if the worker dies, try again in the next."""
        for _ in range(_ATTEMPTS):
            answer: list[Any] = []
            with self._lock:
                worker, state = self._worker_of[slot], self._slots[slot]
                link = self._link(worker)
                number = next(self._numbers)
                self._calls[number] = link, answer
                # Computed for each attempt: in a new worker the environment has to be rebuilt first.
                lost = state.rebuild("") if state.is_lost else None
                messages = self._record_message(worker, record_of)
                link.send(to_bytes([*messages, ("call", number, slot, (method, args, lost))]))
            self.scheduler.wait(lambda answer=answer: bool(answer))  # type: ignore[misc]  # bound early
            (value,) = answer
            if isinstance(value, Failure):
                raise value.error or EnvFaultError(value.message)
            if isinstance(value, WorkerLostError):
                continue  # the call was not the cause: the next worker may answer
            if isinstance(value, Exception):
                raise value
            return value
        raise WorkerLostError(f"{_ATTEMPTS} workers died, one after another, before they answered")


def pack_by_value(thing: object, targets: list[Any]) -> bytes:
    """Pickle an object so that a worker, which does not run the caller's script, can read it.

    Args:
        thing: The object.
        targets: Classes and functions that it refers to; those in modules that a worker could not import are pickled
            by value.

    Raises:
        ArgumentError: It contains an object that cannot be pickled, such as a lock or an open connection.
    """
    import importlib.util
    import sys

    for target in targets:
        module = sys.modules.get(getattr(target, "__module__", None) or "")
        if isinstance(target, str) or module is None or module.__name__ == "__main__":
            continue
        try:
            found = importlib.util.find_spec(module.__name__) is not None
        except (ImportError, ValueError):
            found = False
        if not found and module.__name__ not in cloudpickle.list_registry_pickle_by_value():
            cloudpickle.register_pickle_by_value(module)
    try:
        return cast("bytes", cloudpickle.dumps(thing))
    except Exception as error:
        raise ArgumentError(
            f"what environments are made from cannot be sent to another process: {type(error).__name__}: {error}; give "
            "arguments that can be pickled, and an entry point 'package.module:Class', which is imported there"
        ) from error


def _pack_setup(setup: VectorSetup) -> bytes:
    records = {env_id: registry().env(env_id) for env_id in setup.all_ids}
    wrappers = setup.wrappers if isinstance(setup.wrappers, str | Mapping) else list(setup.wrappers)
    sent = replace(setup, plan=None, wrappers=wrappers, kwargs=dict(setup.kwargs), records=records)
    entry_points = [record.entry_point for record in records.values()]
    return pack_by_value(sent, [*entry_points, *wrapper_targets(wrappers)])


def _permanent_failure(error: Exception) -> Failure:
    return Failure("exception", str(error), error, permanent=True)
