"""``WorkerLoop``: serves the environments of some slots in another process; and the program of such a process."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Any

from gem_core.closing import CLOSING_S, close_all, wait_for_closing
from gem_core.errors import EnvFaultError, GemError
from gem_core.failures import Failure, shown_error
from gem_core.records.plain_json import to_plain
from gem_core.registry.entry_points import load_entry_point
from gem_core.types import Action, ResetResult, StepResult
from gem_core.vector.runner import EnvRunner
from gem_core.vector.setup import VectorSetup


class WorkerLoop:
    """Serves the environments of some slots, one request after another.

    Args:
        setup: Pickled ``VectorSetup``.

    Raises:
        GemError: The setup cannot be used.
    """

    def __init__(self, setup: bytes) -> None:
        try:
            self._setup: VectorSetup = pickle.loads(setup)
            for env_id in self._setup.records:  # imports do not count as time of the first reset
                load_entry_point(self._setup.record(env_id).entry_point, f"environment {env_id!r}")
        except BaseException as error:
            raise _as_gem_error(error) from error
        self._runners: dict[int, EnvRunner] = {}

    def handle(self, request: bytes) -> bytes:
        """Return the reply to a request, which names a method below and has its arguments."""
        try:
            method, args = pickle.loads(request)
        except Exception as error:  # noqa: BLE001 - an object's own unpickling may raise anything
            reply: Any = Failure("exception", f"a request cannot be read in another process: {shown_error(error)}")
        else:
            reply = getattr(self, method)(*args)
        try:
            return pickle.dumps(reply, protocol=5)
        except Exception as error:  # noqa: BLE001 - as above
            message = f"its result cannot be sent to another process: {shown_error(error)}"
            return pickle.dumps(Failure("exception", message))

    # Requests. The first argument is the number of an environment: a slot's former one may still be closing when the
    # next is made.

    def reset(
        self,
        number: int,
        env_id: str | None,
        kwargs: Mapping[str, Any],
        record: bytes | None,
        seed: int,
        options: Mapping[str, Any] | None,
        describe: bool,
    ) -> tuple[ResetResult, Any] | Failure:
        """Begin an episode; return its beginning and, if asked, the description of the environment."""
        runner = self._runner(number)
        if failure := self._make(runner, env_id, kwargs, record):
            return failure
        described = runner.describe() if describe else None
        try:
            pickle.dumps(described)
        except Exception:  # noqa: BLE001 - as above; then in the form that a file of episodes has
            described = to_plain(described)
        outcome = runner.reset(seed, options)
        return outcome if isinstance(outcome, Failure) else (outcome, described)

    def step(self, number: int, action: Action) -> StepResult | Failure:
        """Step an environment."""
        return self._runner(number).step(action)

    def apply(
        self,
        number: int,
        env_id: str | None,
        kwargs: Mapping[str, Any],
        record: bytes | None,
        function: Callable[..., Any],
        args: tuple[Any, ...],
    ) -> Any:
        """Return ``function(env, *args)``; the environment is made if need be."""
        runner = self._runner(number)
        if runner.env is None and (failure := self._make(runner, env_id, kwargs, record)):
            return failure
        try:
            return runner.apply(function, *args)
        except Exception as error:  # noqa: BLE001 - raised again in the program
            return Failure.of(error, getattr(function, "__name__", "a question"))

    def sample_random_action(self, number: int, seed: int | None, agent: str | None) -> str | Failure:
        """Return a valid action."""
        try:
            return self._runner(number).sample_random_action(seed, agent)
        except Exception as error:  # noqa: BLE001 - raised again in the program
            return Failure.of(error, "sample_random_action")

    def close_env(self, number: int) -> None:
        """Close an environment."""
        self._runners.pop(number).close()

    def close(self) -> int:
        """Close all environments at once; return how many had not closed after some seconds."""
        close_all([env for runner in self._runners.values() for env in runner.forget()])
        return wait_for_closing(0.0)

    def _runner(self, number: int) -> EnvRunner:
        if number not in self._runners:
            self._runners[number] = EnvRunner(self._setup.make)
        return self._runners[number]

    def _make(
        self, runner: EnvRunner, env_id: str | None, kwargs: Mapping[str, Any], record: bytes | None
    ) -> Failure | None:
        if record is not None and env_id not in self._setup.records:
            self._setup.records[str(env_id)] = pickle.loads(record)
        return runner.make(env_id, kwargs)


def _as_gem_error(error: BaseException) -> GemError:
    if isinstance(error, GemError):
        return error
    message = Failure.of(error, "starting a worker").message
    return EnvFaultError(
        f"{message}. A worker imports what the environment is made from; give it an entry point "
        "'package.module:Class' that can be imported, or define it in the script itself"
    )


def main(socket: int) -> None:
    """Serve the program at the other end of a socket until it hangs up; the program of a worker process.

    Args:
        socket: Descriptor of the open socket.
    """
    connection = Connection(socket)
    os.set_inheritable(socket, False)
    _raise_oom_score()
    requests: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(connection, requests), name="gem-requests", daemon=True).start()
    code = 1
    loop = None
    try:
        setup = requests.get()
        try:
            loop = WorkerLoop(setup or b"")
        except GemError as error:
            connection.send_bytes(pickle.dumps(error))
        else:
            connection.send_bytes(pickle.dumps(None))
            while (request := requests.get()) is not None:
                connection.send_bytes(loop.handle(request))
            loop.close()
        code = 0
    except OSError:
        code = 0  # the program is gone
    except KeyboardInterrupt:
        code = 130  # an environment raised it: this process has no terminal
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        if not code:
            os.killpg(0, signal.SIGKILL)  # also all processes that its environments started
        os._exit(code)  # without waiting for threads that hang


def _read(connection: Connection, requests: queue.SimpleQueue[bytes | None]) -> None:
    """Pass requests on. When the program is gone, environments have a limited time to close."""
    try:
        while True:
            requests.put(connection.recv_bytes())
    except (EOFError, OSError):
        requests.put(None)
    time.sleep(CLOSING_S + 1.0)
    os.killpg(0, signal.SIGKILL)


def _raise_oom_score() -> None:
    """Ask the kernel to kill this process before the program if memory runs out."""
    try:
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")
    except OSError:
        return  # not Linux, or not allowed
