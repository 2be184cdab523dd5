"""What runs in a worker: the environments of some slots, and the conversation with the host that started it."""

from __future__ import annotations

import mmap
import os
import pickle
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.errors import ArgumentError
from gem_core.jsonable import to_plain
from gem_core.making import make_from
from gem_core.registry import registry
from gem_core.specs import EnvSpec
from gem_core.types import Concurrency
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild
from gem_core.vector.host import Host, Launch
from gem_core.vector.local import LocalHost, answer, wrappers_of
from gem_core.wrapper import AnyEnv

Message = tuple[Any, ...]

_CLOSING_S = 5.0
"""How long the environments of a worker may take to close once nobody needs them any more."""


class Worker:
    """Environments of some slots, run as each asks for, and what is said about them.

    It takes ``("do", slot, ticket, command)``, ``("ask", number, slot, question, args)``, ``("release", slot)`` and
    ``("know", records)``, and gives back what the host could not send; it says ``("done", slot, ticket, outcome)``,
    ``("answer", number, worked, value)``, and once for each id, before anything else of it,
    ``("wrapped", id, wrappers)``.

    Args:
        setup: What environments are made from; see ``remote.worker_setup``.
        say: Takes what it says, from any thread.
        times: Where it notes since when a slot's command runs.
    """

    def __init__(
        self, setup: bytes, say: Callable[[Message], None], times: MutableMapping[int, float] | None = None
    ) -> None:
        fields: dict[str, Any] = pickle.loads(setup)
        self._say = say
        self._records: dict[str, EnvSpec] = {record.id: record for record in fields["records"]}
        self._kwargs, self._wrappers = fields["kwargs"], fields["wrappers"]
        self._times: MutableMapping[int, float] = {} if times is None else times
        self._told: set[str | None] = set()
        factories = [self._factory(own_id) for own_id in fields["ids"]]
        self._host = LocalHost(factories, kinds=self._kind, started=self._times)
        self._host.engine = self

    def take(self, message: Message) -> None:
        """Do what the host says."""
        kind = message[0]
        if kind == "do":
            self._do(*message[1:])
        elif kind == "ask":
            _, number, slot, question, args = message
            try:
                value = self._answer(slot, question, args)
            except Exception as error:  # noqa: BLE001 - it is raised where it was asked
                where = "sample_random_action" if question == "sample" else question
                self._say(("answer", number, False, Failure.of(error, where)))
            else:
                self._say(("answer", number, True, value))
        elif kind == "return":
            self._say(("done", *message[1:]))
        elif kind == "refuse":
            self._say(("answer", *message[1:]))
        elif kind == "release":
            self._host.release(message[1])
        elif kind == "know":
            self._records |= {record.id: record for record in pickle.loads(message[1])}

    def close(self) -> None:
        """Close every environment."""
        self._host.close()

    # What its own host tells.

    def advance(self, host: Host, slot: int, ticket: int, outcome: Outcome) -> Launch | None:
        """Say what came of a command."""
        self._done(slot, ticket, outcome)
        return None

    def is_current(self, slot: int, ticket: int) -> bool:
        """Tell that every command is waited for; a worker that is not is killed."""
        return True

    def lose(self, host: Host, guilty: dict[int, Failure], others: list[int]) -> None:
        """Never called: a local host loses nothing."""

    def look_after(self, host: Host) -> float | None:
        """Never called: a local host answers at once."""
        return None

    def first_under_way(self, slots: list[int]) -> list[int]:
        """Never called: a local host does not die."""
        return []

    def _do(self, slot: int, ticket: int, command: Command) -> None:
        body = self._host.in_place(slot, command)
        if isinstance(command, Rebuild):
            body = body or self._host.in_place(slot, command.reset)
        if body is None:
            self._host.start([(slot, ticket, command)])
            return
        self._times[slot] = time.monotonic()
        outcome = body.perform(command)
        self._times.pop(slot, None)
        self._done(slot, ticket, outcome)

    def _done(self, slot: int, ticket: int, outcome: Outcome) -> None:
        body = self._host.body(slot)
        if body.made_for is not None and body.made_for[0] not in self._told:
            self._told.add(body.made_for[0])
            self._say(("wrapped", body.made_for[0], wrappers_of(body.env)))
        self._say(("done", slot, ticket, outcome))

    def _answer(self, slot: int, question: str, args: tuple[Any, ...]) -> Any:
        body = self._host.body(slot)
        if question == "sample" and body.env is None and args[1] is not None:
            body.restore(args[1])
        return answer(body, question, *args)

    def _factory(self, own_id: str) -> Callable[[str | None, Mapping[str, Any]], AnyEnv]:
        def factory(env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
            record = self._record(env_id or own_id)
            return make_from(record, {**self._kwargs, **overrides}, self._wrappers, registry().wrapper)

        return factory

    def _record(self, env_id: str) -> EnvSpec:
        return self._records.get(env_id) or registry().env(env_id)

    def _kind(self, env_id: str | None) -> Concurrency | None:
        """Return what a task asks for; what computes for long runs in place here, as workers are for that."""
        from gem_core.making import load_entry_point

        if env_id is None:
            return None
        kind = getattr(load_entry_point(self._record(env_id).entry_point, env_id), "concurrency", None)
        return "inline" if kind == "process" else cast("Concurrency | None", kind)


class SharedTimes(MutableMapping[int, float]):
    """Since when each slot's command runs, in memory that the host sees even when the worker is dead.

    Args:
        file: Number of an open file, of eight bytes for each slot.
        slots: Number of slots.
    """

    def __init__(self, file: int, slots: int) -> None:
        self._map = mmap.mmap(file, max(8, 8 * slots))
        self._times = memoryview(self._map).cast("d")

    def __setitem__(self, slot: int, since: float) -> None:
        self._times[slot] = since

    def __getitem__(self, slot: int) -> float:
        since = self._times[slot]
        if not since:
            raise KeyError(slot)
        return since

    def __delitem__(self, slot: int) -> None:
        if not self._times[slot]:
            raise KeyError(slot)
        self._times[slot] = 0.0

    def __iter__(self) -> Iterator[int]:
        return iter([slot for slot, since in enumerate(self._times.tolist()) if since])

    def __len__(self) -> int:
        return sum(map(bool, self._times.tolist()))

    def present(self) -> dict[int, float]:
        """Return all that is noted, read at once: between two looks, the worker goes on."""
        return {slot: since for slot, since in enumerate(self._times.tolist()) if since}


class Outbox:
    """Sends messages over a connection from a thread of its own, so that nobody waits for the other side to read.

    What has come together by the time that the thread looks goes out as one.

    Args:
        send: Sends bytes; it may block, and raises ``OSError`` when the other side is gone.
        first: Sent by itself before any message.
    """

    def __init__(self, send: Callable[[bytes], None], first: bytes = b"") -> None:
        self._send = send
        self._first = first
        self._queue: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="gem-outbox", daemon=True)
        self._thread.start()

    def put(self, message: Message) -> None:
        """Send a message, in order, at some time."""
        self._queue.put(message)

    def close(self, timeout: float | None = None) -> None:
        """Send what is still there, and end the thread."""
        self._queue.put(None)
        self._thread.join(timeout)

    def _serve(self) -> None:
        try:
            if self._first:
                self._send(self._first)
            for batch in batches(self._queue):
                self._send(batch)
        except OSError:
            return  # whoever reads the other way finds out that it is gone


def batches(messages: queue.SimpleQueue[Message | None]) -> Iterator[bytes]:
    """Yield messages as bytes, each time all that have come together, until one of them is None."""
    over = False
    while not over:
        together = [messages.get()]
        while not messages.empty():
            together.append(messages.get())
        over = None in together
        yield _dumped([message for message in together if message is not None])


def broken(error: BaseException) -> Message:
    """Return what a worker says that cannot be started; trying again would not help."""
    failure = Failure.of(error, "starting a worker")
    failure.error, failure.hopeless = _as_ours(failure), True
    return ("broken", failure)


def _dumped(messages: list[Message]) -> bytes:
    try:
        return pickle.dumps(messages, protocol=5)
    except Exception:  # noqa: BLE001 - an object's own pickling may fail in any way
        return cloudpickle.dumps([_sendable(message) for message in messages])  # type: ignore[no-any-return]  # untyped


def _sendable(message: Message) -> Message:
    """Return a message, or in the place of one that cannot be sent what says so."""
    try:
        cloudpickle.dumps(message)
    except Exception as error:  # noqa: BLE001 - as above
        if message[0] == "wrapped":
            return (*message[:2], to_plain(message[2]))  # as it would stand in a file of episodes
        what = {"do": "what it is made from", "ask": "a question"}.get(message[0], "its result")
        text = f"{what} cannot be sent to another process: {type(error).__name__}: {error}"
        failure = Failure("exception", text[:2000])
        if message[0] == "do":
            # Trying again would end the same way.
            failure.error, failure.hopeless = ArgumentError(failure.message), True
        if message[0] in ("do", "done"):
            return ("return" if message[0] == "do" else "done", *message[1:3], failure)
        return ("refuse" if message[0] == "ask" else "answer", message[1], False, failure)
    return message


def main(socket: int, lifeline: int, times: int) -> None:
    """Serve the host at the other end of a socket, until it hangs up.

    Args:
        socket: Number of the open socket.
        lifeline: Number of a pipe that the host holds open while it lives.
        times: Number of the open file for ``SharedTimes``.
    """
    from multiprocessing.connection import Connection

    connection = Connection(socket)
    _be_killed_first()
    threading.Thread(target=_end_with, args=(lifeline,), name="gem-lifeline", daemon=True).start()
    outbox = Outbox(connection.send_bytes)
    try:
        setup = connection.recv_bytes()
        fields = pickle.loads(setup)
        _limit_memory(fields["worker_memory_bytes"])
        worker = Worker(setup, outbox.put, SharedTimes(times, len(fields["ids"])))
    except EOFError:
        return
    except BaseException as error:  # noqa: BLE001 - whatever it is, the host has to know
        outbox.put(broken(error))
        outbox.close(_CLOSING_S)
        return
    try:
        while True:
            for message in pickle.loads(connection.recv_bytes()):
                worker.take(message)
    except (EOFError, OSError):
        worker.close()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)  # a thread that hangs does not hold it up


def _as_ours(failure: Failure) -> BaseException:
    from gem_core.errors import EnvFaultError, GemError

    if isinstance(failure.error, GemError):
        return failure.error
    return EnvFaultError(
        f"{failure.message}. A worker imports what the environment is made from; give it an entry point "
        "'package.module:Class' that can be imported, or define it in the script itself"
    )


def _end_with(lifeline: int) -> None:
    """End this process, and what it started, when the host is gone and closing takes too long."""
    os.read(lifeline, 1)
    time.sleep(_CLOSING_S)
    os.killpg(0, 9)


def _be_killed_first() -> None:
    """Let a machine that runs out of memory kill this process rather than the one that trains."""
    try:
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")
    except OSError:
        return  # not Linux, or not allowed


def _limit_memory(limit: int | None) -> None:
    if limit is not None:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
