"""``RemoteHost``: environments in workers that can be killed and replaced, whatever a worker is made of."""

from __future__ import annotations

import concurrent.futures
import itertools
import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.errors import ArgumentError, EnvFaultError, WorkerLostError
from gem_core.making.layers import wrapper_targets
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EnvSpec
from gem_core.vector.commands import Failure, Reset
from gem_core.vector.host import Host, Launch, free
from gem_core.vector.local import timeout_of
from gem_core.vector.setup import VectorSetup

Message = tuple[Any, ...]
"""What goes between a host and a worker; the first part says what it is. See ``worker.Worker``."""

_ABSENT = object()

_ATTEMPTS = 3
"""Workers that may die while they are asked something, before this is given up."""


class Link(ABC):
    """A worker, seen from the process that uses it.

    It calls ``on_messages`` with what the worker says, and ``on_death`` once, when there will be no more of it; both
    from a thread of its own.
    """

    @abstractmethod
    def send(self, messages: list[Message]) -> None:
        """Hand messages to the worker, in order, without waiting for it; one that is dead takes no notice."""

    @abstractmethod
    def running(self) -> dict[int, float]:
        """Return the slots whose command runs at this moment, or ran when it died, and since when.

        The times are those of ``time.monotonic()`` in this process.
        """

    @abstractmethod
    def death(self) -> str:
        """Say how it died."""

    @abstractmethod
    def kill(self) -> None:
        """End the worker at once, and all that it has started."""

    @abstractmethod
    def close(self) -> None:
        """Let the worker close its environments, and end it."""


NewLink = Callable[[Callable[[Link, list[Message]], None], Callable[[Link], None]], Link]
"""Starts a worker, given ``on_messages`` and ``on_death``."""


def weakly(method: Callable[..., None]) -> Callable[[], Callable[..., None] | None]:
    """Return what gives a method while its object lives: a thread that waits keeps no vector environment alive."""
    return weakref.WeakMethod(method) if hasattr(method, "__self__") else lambda: method


class RemoteHost(Host):
    """Runs environments in workers, many in each, and replaces a worker that dies or has to be killed.

    Args:
        setup: What environments are made from.
        new_link: Starts a worker.
        workers: Number of them; the slots take them in turn.
    """

    replays = True

    def __init__(self, setup: VectorSetup, new_link: NewLink, workers: int) -> None:
        self._setup = setup
        self._new_link = new_link
        self._worker_of = [slot % workers for slot in range(len(setup.ids))]
        self._links: list[Link | None] = [None] * workers
        self._known: list[set[str]] = [set() for _ in range(workers)]
        self._present: dict[int, Reset] = {}
        self._wrappers: dict[str | None, list[Any]] = {}
        self._lock = threading.RLock()
        self._numbers = itertools.count()
        self._asked: dict[int, tuple[Link, concurrent.futures.Future[Any]]] = {}
        self._broken: dict[Link, Failure] = {}

    def start(self, batch: list[Launch]) -> None:
        """Send each command to its worker, all of one worker's at once."""
        with self._lock:
            messages: dict[int, list[Message]] = {}
            for slot, ticket, command in batch:
                if not self.engine.is_current(slot, ticket):
                    continue  # its worker has died since, and the slot has gone on
                worker = self._worker_of[slot]
                self._link(worker)
                if isinstance(command, Reset):
                    self._present[slot] = command
                    messages.setdefault(worker, []).extend(self._introduced(worker, command.env_id))
                messages.setdefault(worker, []).append(("do", slot, ticket, command))
            for worker, those in messages.items():
                self._link(worker).send(those)

    def ask(self, slot: int, question: str, *args: Any) -> Any:
        """Answer a question, here or by the worker; see ``Host.ask``."""
        if question == "describe":
            return self._described(slot)
        for _ in range(_ATTEMPTS):
            future: concurrent.futures.Future[Any] = concurrent.futures.Future()
            with self._lock:
                worker = self._worker_of[slot]
                link = self._link(worker)
                number = next(self._numbers)
                self._asked[number] = link, future
                known = self._introduced(worker, args[0]) if question in ("num_tasks", "endless_tasks") else []
                # Whether the environment has to be rebuilt is known only now, and changes with the worker.
                present = tuple(arg() if callable(arg) else arg for arg in args)
                link.send([*known, ("ask", number, slot, question, present)])
            while True:
                try:
                    return future.result(self.engine.look_after(self))
                except concurrent.futures.TimeoutError:
                    continue  # what holds the worker up may have to be given up first
                except WorkerLostError:
                    break  # whoever asked did nothing wrong: the next worker may answer
        raise WorkerLostError(f"{_ATTEMPTS} workers died, one after another, before they answered")

    def release(self, slot: int) -> None:
        """Close a slot's environment, if its worker is there."""
        with self._lock:
            self._present.pop(slot, None)
            link = self._links[self._worker_of[slot]]
            if link is not None:
                link.send([("release", slot)])

    def overdue(self, now: float) -> list[int]:
        """Return the slots whose command takes too long."""
        limit = self._setup.step_timeout
        if limit is None:
            return []
        return [slot for slot, since in self._running().items() if now - since >= limit]

    def next_check(self, now: float) -> float | None:
        """Return in how many seconds the first command that runs is overdue."""
        limit = self._setup.step_timeout
        if limit is None:
            return None
        # Commands wait for one another in a worker: the next may begin at any moment, and be overdue then.
        return max(0.001, min(self._running().values(), default=now) + limit - now)

    def timed_out(self, slot: int) -> Failure:
        """Return what is said of a command that took too long."""
        return timeout_of(cast("float", self._setup.step_timeout))

    def abandon(self, slot: int, failure: Failure) -> Failure:
        """Kill the worker; its other slots go on in a new one."""
        with self._lock:
            worker = self._worker_of[slot]
            link = self._links[worker]
            if link is not None:
                self._forget(worker, link)
                link.kill()
                self.engine.lose(self, {}, [other for other in self._slots_of(worker) if other != slot])
        return failure

    def close(self) -> None:
        """End every worker; their environments are closed first."""
        with self._lock:
            links = [(worker, link) for worker, link in enumerate(self._links) if link is not None]
            for worker, link in links:
                self._forget(worker, link, EnvFaultError("the vector environment was closed before it answered"))
            self._present.clear()
        threads = [threading.Thread(target=link.close, name="gem-close", daemon=True) for _, link in links]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def renewed(self) -> RemoteHost:
        """Return a host without workers; see ``Host.renewed``."""
        free(self._lock)
        return RemoteHost(self._setup, self._new_link, len(self._links))

    # What links tell, from threads of their own.

    def on_messages(self, link: Link, messages: list[Message]) -> None:
        """Take what a worker says."""
        following: list[Launch] = []
        for message in messages:
            if message[0] == "done":
                _, slot, ticket, outcome = message
                if (launch := self.engine.advance(self, slot, ticket, outcome)) is not None:
                    following.append(launch)
            elif message[0] == "answer":
                _, number, worked, value = message
                _, future = self._asked.pop(number, (None, None))
                if future is not None:
                    future.set_result(value) if worked else future.set_exception(_raisable(value))
            elif message[0] == "wrapped":
                self._wrappers[message[1]] = message[2]
            elif message[0] == "broken":
                self._broken[link] = message[1]
        if following:
            self.start(following)

    def on_death(self, link: Link) -> None:
        """Tell the slots of a worker that it is gone, and which of them it was."""
        with self._lock:
            broken = self._broken.pop(link, None)
            if link not in self._links:
                return  # it was closed or killed on purpose
            worker = self._links.index(link)
            running = link.running()
            self._forget(worker, link)
            slots = self._slots_of(worker)
            if broken is not None:
                self.engine.lose(self, dict.fromkeys(slots, broken), [])
                return
            among = "" if len(running) < 2 else f", while it was one of {len(running)} environments that ran in it"
            failure = Failure("died", f"its worker process {link.death()}{among}")
            guilty = [slot for slot in slots if slot in running] or self.engine.first_under_way(slots)
            self.engine.lose(self, dict.fromkeys(guilty, failure), [slot for slot in slots if slot not in guilty])

    # Its own matters.

    def _link(self, worker: int) -> Link:
        link = self._links[worker]
        if link is None:
            link = self._links[worker] = self._new_link(self.on_messages, self.on_death)
            self._known[worker] = set(self._setup.all_ids)
        return link

    def _forget(self, worker: int, link: Link, why: Exception | None = None) -> None:
        self._links[worker] = None
        for number, (asked, future) in list(self._asked.items()):
            if asked is link:
                del self._asked[number]
                future.set_exception(why or WorkerLostError("the worker died before it answered"))

    def _slots_of(self, worker: int) -> list[int]:
        return [slot for slot, own in enumerate(self._worker_of) if own == worker]

    def _running(self) -> dict[int, float]:
        running: dict[int, float] = {}
        for link in list(self._links):
            if link is not None:
                running |= link.running()
        return running

    def _introduced(self, worker: int, env_id: str | None) -> list[Message]:
        """Return what makes an id known to a worker: the program may have registered it by itself."""
        if env_id is None or env_id in self._known[worker]:
            return []
        self._known[worker].add(env_id)
        return [("know", packed([registry().env(env_id)]))]

    def _described(self, slot: int) -> dict[str, Any]:
        present = self._present.get(slot)
        if present is None or present.env_id is None:
            return {"id": None, "kwargs": {}, "wrappers": []}
        env_id = present.env_id
        registered = registry().env(env_id).kwargs
        kwargs = {**registered, **self._setup.kwargs, **present.kwargs}
        changed = {name: value for name, value in kwargs.items() if registered.get(name, _ABSENT) is not value}
        return {"id": env_id, "kwargs": changed, "wrappers": self._wrappers.get(env_id, [])}


def packed(records: list[EnvSpec]) -> bytes:
    """Return records as bytes; what a script or a notebook defines itself goes along by value."""
    return pack_by_value(records, [record.entry_point for record in records])


def pack_by_value(thing: object, callables: list[Any]) -> bytes:
    """Pickle something so that a worker, which does not run the caller's script, can read it.

    Args:
        thing: What is pickled.
        callables: What it refers to; modules of these that a worker could not import go along by value.

    Raises:
        ArgumentError: It holds what cannot be pickled, such as a lock or an open connection.
    """
    import importlib.util
    import sys

    for target in callables:
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


def worker_setup(setup: VectorSetup, options: Mapping[str, Any]) -> bytes:
    """Return what a worker is made from; see ``worker.Worker``."""
    records = [registry().env(env_id) for env_id in setup.all_ids]
    wrappers = setup.wrappers if isinstance(setup.wrappers, str) else list(setup.wrappers)
    makers = wrapper_targets(wrappers)
    return pack_by_value(
        {
            "records": records,
            "ids": setup.ids,
            "wrappers": wrappers,
            "kwargs": dict(setup.kwargs),
            **options,
        },
        [*(record.entry_point for record in records), *makers],
    )


def _raisable(value: object) -> BaseException:
    if isinstance(value, Failure):
        return value.error or EnvFaultError(value.message)
    return EnvFaultError(str(value))
