"""``Worker``: runs the environments of some slots in another process, as messages tell it to."""

from __future__ import annotations

import errno
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from gem_core.errors import EnvFaultError, GemError
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Reset
from gem_core.vector.executor import CommandTimes
from gem_core.vector.local import LocalExecutor
from gem_core.vector.setup import VectorSetup
from gem_core.vector.workers.messages import WorkerMessage, batches, from_bytes

_CLOSING_S = 5.0
"""Seconds that the environments of a worker may take to close when the program hangs up."""


class Worker:
    """Runs the environments of some slots, each as its ``concurrency`` requires.

    It exchanges messages with a ``RemoteExecutor``, as bytes. If the setup cannot be used, the only message that it
    sends is the reason.

    Args:
        setup: ``RemoteExecutor.packed``.
        times: Descriptor of an open file for ``CommandTimes``, which ``WorkerLink.running`` reads.
    """

    def __init__(self, setup: bytes, times: int) -> None:
        self._outbox: queue.SimpleQueue[WorkerMessage | None] = queue.SimpleQueue()
        self._reported_envs: dict[int, Any] = {}
        self._executor: LocalExecutor | None = None
        try:
            self._setup: VectorSetup = pickle.loads(setup)
            self._times = CommandTimes(len(self._setup.ids), times)
            # Long computations run in place here: that is what workers are for.
            self._executor = LocalExecutor(self._setup, in_place=["inline", "process"], times=self._times)
            self._executor.scheduler = self
        except BaseException as error:  # noqa: BLE001 - any failure is reported to the program
            self.fail(error, "starting a worker")

    @property
    def is_broken(self) -> bool:
        """Whether the setup could not be used."""
        return self._executor is None

    def take(self, data: bytes) -> None:
        """Handle messages from the program."""
        if self._executor is None:
            return
        for message in from_bytes(data):
            kind = message[0]
            if kind == "do":
                self._do(self._executor, *message[1:])
            elif kind == "call":
                self._call(self._executor, *message[1:])
            elif kind == "release":
                self._executor.release(message[1])
            elif kind == "know":
                self._setup.records |= {record.id: record for record in pickle.loads(message[1])}

    def given(self) -> Iterator[bytes]:
        """Yield the messages to the program, as soon as there are some, until it is closed."""
        return batches(self._outbox)

    def fail(self, error: BaseException, where: str) -> None:
        """Send the reason why neither this worker nor another can continue, as the last message."""
        failure = Failure.of(error, where)
        failure.error, failure.permanent = _as_gem_error(failure), True
        self._outbox.put(("broken", failure))
        self._outbox.put(None)

    def close(self) -> None:
        """Close every environment."""
        if self._executor is not None:
            self._executor.close()
        self._outbox.put(None)

    def advance(self, slot: int, ticket: int, outcome: Outcome) -> None:
        """Send the outcome of a command; see ``Listener``."""
        runner = self._executor.runners[slot] if self._executor is not None else None
        if runner is not None and runner.env is not None and self._reported_envs.get(slot) is not runner.env:
            self._reported_envs[slot] = runner.env
            self._outbox.put(("made", slot, runner.describe()))
        self._outbox.put(("done", slot, ticket, outcome))

    def _do(self, executor: LocalExecutor, slot: int, ticket: int, command: Command | Failure) -> None:
        if isinstance(command, Failure):
            self.advance(slot, ticket, command)  # the command could not be sent here
            return
        begins = command.reset if isinstance(command, Rebuild) else command
        if isinstance(begins, Reset):
            try:
                self._setup.task_concurrency(begins.env_id)  # imports do not count as time of the command
            except Exception as error:  # noqa: BLE001 - a module may raise anything while it is imported
                self.advance(slot, ticket, Failure.of(error, "reset", making=True))
                return
        # Making the environment may take long, too, or end the worker.
        self._times.begin(slot)
        runner = executor.in_place(slot, command)
        if runner is None:
            executor.start([(slot, ticket, command)])
            return
        outcome = runner.perform(command)
        self._times.end(slot)
        self.advance(slot, ticket, outcome)

    def _call(self, executor: LocalExecutor, number: int, slot: int, call: Any) -> None:
        value: object
        method = "a question"
        try:
            if isinstance(call, Failure):
                raise call.error or RuntimeError(call.message)
            method, args, lost = call
            if lost is not None and executor.runners[slot].env is None:
                executor.runners[slot].restore(lost)
            value = getattr(executor, method)(slot, *args)
        except Exception as error:  # noqa: BLE001 - raised again in the program that made the call
            value = Failure.of(error, method)
        self._outbox.put(("answer", number, value))


def _as_gem_error(failure: Failure) -> GemError:
    error = failure.error
    if isinstance(error, GemError):
        return error
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return EnvFaultError(f"{failure.message}. A worker has too little memory to start; see worker_memory_bytes")
    return EnvFaultError(
        f"{failure.message}. A worker imports what the environment is made from; give it an entry point "
        "'package.module:Class' that can be imported, or define it in the script itself"
    )


# A worker process; see ``process.ProcessLink``.


def main(socket: int, lifeline: int, times: int, memory_bytes: int) -> None:
    """Serve the program at the other end of a socket until it closes the socket.

    Args:
        socket: Descriptor of the open socket.
        lifeline: Descriptor of a pipe that the program holds open while it lives.
        times: Descriptor of the open file for ``CommandTimes``.
        memory_bytes: Address space that may be used; 0 for no limit.
    """
    connection = Connection(socket)
    _be_killed_first()
    threading.Thread(target=_end_with, args=(lifeline,), name="gem-lifeline", daemon=True).start()
    # Results are sent from another thread, so that environments go on while the program does not read. The thread is
    # started before memory is limited.
    made: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    giving = threading.Thread(target=_write_messages, args=(made, connection), name="gem-outbox", daemon=True)
    giving.start()
    code = 1
    try:
        setup = connection.recv_bytes()
        if memory_bytes:
            import resource

            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        worker = Worker(setup, times)
        made.put(worker)
        code = _serve(worker, connection)
        if code == 1:
            giving.join(_CLOSING_S)
    except EOFError:
        code = 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        if not code:
            os.killpg(0, signal.SIGKILL)  # also all processes that its environments started
        os._exit(code)  # without waiting for threads that hang


def _serve(worker: Worker, connection: Connection) -> int:
    """Handle messages until the program closes the connection; return an exit code."""
    try:
        while not worker.is_broken and (data := _receive(connection)) is not None:
            worker.take(data)
        worker.close()
    except KeyboardInterrupt:
        return 130  # an environment raised it: this process has no terminal
    except BaseException as error:  # noqa: BLE001 - any failure is reported to the program
        worker.fail(error, "a worker")
    else:
        return int(worker.is_broken)
    return 1


def _write_messages(made: queue.SimpleQueue[Worker], connection: Connection) -> None:
    try:
        for data in made.get().given():
            connection.send_bytes(data)
    except OSError:
        return  # the program is gone, which main notices, too
    except MemoryError:
        os._exit(1)


def _receive(connection: Connection) -> bytes | None:
    try:
        return connection.recv_bytes()
    except (EOFError, OSError):
        return None


def _end_with(lifeline: int) -> None:
    """End this process and its children when the program is gone and closing takes too long."""
    os.read(lifeline, 1)
    time.sleep(_CLOSING_S)
    os.killpg(0, signal.SIGKILL)


def _be_killed_first() -> None:
    """Let a machine that runs out of memory kill this process before the one that trains."""
    try:
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")
    except OSError:
        return  # not Linux, or not allowed
