"""What runs in a worker: the environments of some slots, and the conversation with the host that started it."""

from __future__ import annotations

import errno
import mmap
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from multiprocessing.connection import Connection
from typing import Any, cast

from gem_core.env.wrapper import AnyEnv
from gem_core.making.environment import make_from
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EnvSpec
from gem_core.types import Concurrency
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Reset
from gem_core.vector.host import Host, Launch
from gem_core.vector.local import LocalHost, answer, wrappers_of
from gem_core.vector.wire import Message, Outbox, from_bytes

_CLOSING_S = 5.0
"""How long the environments of a worker may take to close once nobody needs them any more."""


class Worker:
    """Environments of some slots, run as each asks for, and what is said about them.

    It takes ``("do", slot, ticket, command)``, ``("ask", number, slot, question, args)``, ``("release", slot)`` and
    ``("know", records)``; and says ``("done", slot, ticket, outcome)``, ``("answer", number, worked, value)``, and once
    for each id, before anything else of it, ``("wrapped", id, wrappers)``. In the place of a command or of arguments
    that could not be sent there is a ``Failure``, which it gives back.

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
        self._closed = False
        self._records: dict[str, EnvSpec] = {record.id: record for record in fields["records"]}
        self._kwargs, self._wrappers = fields["kwargs"], fields["wrappers"]
        self._times: MutableMapping[int, float] = {} if times is None else times
        self._told: set[str | None] = set()
        factories = [self._factory(own_id) for own_id in fields["ids"]]
        # What computes for long runs in place here, as workers are for that.
        self._host = LocalHost(factories, kinds=self._kind, started=self._times, in_place=("inline", "process"))
        self._host.engine = self

    def take(self, message: Message) -> None:
        """Do what the host says."""
        kind = message[0]
        if kind == "do":
            self._do(*message[1:])
        elif kind == "ask":
            _, number, slot, question, args = message
            try:
                if isinstance(args, Failure):
                    raise args.error or RuntimeError(args.message)
                value = self._answer(slot, question, args)
            except Exception as error:  # noqa: BLE001 - it is raised where it was asked
                where = "sample_random_action" if question == "sample" else question
                self._say(("answer", number, False, Failure.of(error, where)))
            else:
                self._say(("answer", number, True, value))
        elif kind == "release":
            self._host.release(message[1])
        elif kind == "know":
            self._records |= {record.id: record for record in pickle.loads(message[1])}

    def close(self) -> None:
        """Close every environment."""
        self._closed = True
        self._host.close()

    # What its own host tells.

    def advance(self, host: Host, slot: int, ticket: int, outcome: Outcome) -> Launch | None:
        """Say what came of a command."""
        self._done(slot, ticket, outcome)
        return None

    def is_current(self, slot: int, ticket: int) -> bool:
        """Tell that every command is waited for, until the host hangs up; a worker that is not is killed."""
        return not self._closed

    def lose(self, host: Host, guilty: dict[int, Failure], others: list[int]) -> None:
        """Never called: a local host loses nothing."""

    def look_after(self, host: Host) -> float | None:
        """Never called: a local host answers at once."""
        return None

    def first_under_way(self, slots: list[int]) -> list[int]:
        """Never called: a local host does not die."""
        return []

    def _do(self, slot: int, ticket: int, command: Command | Failure) -> None:
        if isinstance(command, Failure):
            self._say(("done", slot, ticket, command))  # it could not be sent here
            return
        begins = command.reset if isinstance(command, Rebuild) else command
        if isinstance(begins, Reset):
            try:
                self._kind(begins.env_id)  # what it imports does not count as its time
            except Exception as error:  # noqa: BLE001 - a module may fail in any way while it is imported
                self._say(("done", slot, ticket, Failure.of(error, "reset", making=True)))
                return
        # To make the environment may take long, and be the death of the worker, as well.
        self._times[slot] = time.monotonic()
        body = self._host.in_place(slot, command) or self._host.in_place(slot, begins)
        if body is None:
            self._host.start([(slot, ticket, command)])
            return
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
            return make_from(record, {**self._kwargs, **overrides}, self._wrappers)

        return factory

    def _record(self, env_id: str) -> EnvSpec:
        return self._records.get(env_id) or registry().env(env_id)

    def _kind(self, env_id: str | None) -> Concurrency | None:
        """Return what a task asks for."""
        from gem_core.registry.entry_points import load_entry_point

        if env_id is None:
            return None
        entry_point = load_entry_point(self._record(env_id).entry_point, f"environment {env_id!r}")
        return cast("Concurrency | None", getattr(entry_point, "concurrency", None))


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
        self._times[slot] = 0.0  # also when another thread was faster

    def clear(self) -> None:
        """Note that nothing runs."""
        for slot in range(len(self._times)):
            self._times[slot] = 0.0

    def __iter__(self) -> Iterator[int]:
        return iter([slot for slot, since in enumerate(self._times.tolist()) if since])

    def __len__(self) -> int:
        return sum(map(bool, self._times.tolist()))

    def present(self) -> dict[int, float]:
        """Return all that is noted, read at once: between two looks, the worker goes on."""
        return {slot: since for slot, since in enumerate(self._times.tolist()) if since}


def broken(error: BaseException) -> Message:
    """Return what a worker says that cannot be started; trying again would not help."""
    failure = Failure.of(error, "starting a worker")
    failure.error, failure.hopeless = _as_ours(failure), True
    return ("broken", failure)


def main(socket: int, lifeline: int, times: int) -> None:
    """Serve the host at the other end of a socket, until it hangs up.

    Args:
        socket: Number of the open socket.
        lifeline: Number of a pipe that the host holds open while it lives.
        times: Number of the open file for ``SharedTimes``.
    """
    connection = Connection(socket)
    _be_killed_first()
    threading.Thread(target=_end_with, args=(lifeline,), name="gem-lifeline", daemon=True).start()
    outbox = Outbox(connection.send_bytes, failed=lambda: os._exit(1))
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
    code = 0
    try:
        while (data := _received(connection)) is not None:
            for message in from_bytes(data):
                worker.take(message)
        worker.close()
    except KeyboardInterrupt:
        code = 130  # an environment raised it: this process has no terminal
    except BaseException as error:  # noqa: BLE001 - as above
        code = 1
        outbox.put(("broken", Failure.of(error, "a worker")))
        outbox.close(_CLOSING_S)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        if not code:
            os.killpg(0, signal.SIGKILL)  # what its environments started, also when the host is gone
        os._exit(code)  # a thread that hangs does not hold it up


def _received(connection: Connection) -> bytes | None:
    try:
        return connection.recv_bytes()
    except (EOFError, OSError):
        return None


def _as_ours(failure: Failure) -> BaseException:
    from gem_core.errors import EnvFaultError, GemError

    error = failure.error
    if isinstance(error, GemError):
        return error
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return EnvFaultError(f"{failure.message}. A worker has too little memory to start; see worker_memory_bytes")
    return EnvFaultError(
        f"{failure.message}. A worker imports what the environment is made from; give it an entry point "
        "'package.module:Class' that can be imported, or define it in the script itself"
    )


def _end_with(lifeline: int) -> None:
    """End this process, and what it started, when the host is gone and closing takes too long."""
    os.read(lifeline, 1)
    time.sleep(_CLOSING_S)
    os.killpg(0, signal.SIGKILL)


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
