"""``RayWorker``: a worker in an actor of a Ray cluster."""

from __future__ import annotations

import atexit
import concurrent.futures
import os
import pickle
import sys
import time
import weakref
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, cast

import ray
from ray.exceptions import ActorDiedError, ActorUnavailableError, RayError

from gem_core.closing import CLOSING_S
from gem_core.errors import EnvFaultError, GemError
from gem_core.vector import NoRoomError, Worker, WorkerDiedError, WorkerLoop
from gem_ray.cluster import cluster_resources, connection

_workers: weakref.WeakSet[RayWorker] = weakref.WeakSet()

_LOOKING_S = 0.5
"""How often a thread that waits for a reply looks whether the program is still connected to Ray."""


class EnvActor:
    """The actor.

    Args:
        path: ``sys.path`` of the program; its folders that exist here are searched last.
    """

    def __init__(self, path: list[str]) -> None:
        sys.path.extend(entry for entry in path if entry not in sys.path and os.path.exists(entry))
        self._loop: WorkerLoop | None = None

    def handle(self, request: bytes) -> bytes:
        """Return the reply to a request; the first is the pickled setup, whose reply is its error, or None."""
        if self._loop is not None:
            return self._loop.handle(request)
        problem = None
        try:
            self._loop = WorkerLoop(request)
        except GemError as error:
            problem = error
        return pickle.dumps(problem)

    def close(self) -> None:
        """Close the environments."""
        if self._loop is not None:
            self._loop.close()

    __ray_shutdown__ = close
    """Ray calls it when the vector environment is garbage-collected, but not at the end of the program."""


class RayWorker(Worker):
    """A worker in an actor.

    Args:
        packed: Pickled ``VectorSetup``.
        options: Of the actor, such as ``num_cpus``.
        start_timeout: Seconds that Ray may take to place and start it; afterwards the environments are imported.

    Raises:
        NoRoomError: Ray did not start it in time.
        GemError: It cannot be started, or the setup cannot be used there.
        WorkerDiedError: It ended at its start.
    """

    def __init__(self, packed: bytes, options: Mapping[str, Any], start_timeout: float) -> None:
        self._connection = connection()
        self._killed = False
        made: Any = ray.remote(max_restarts=0, max_task_retries=0)(EnvActor)
        self.actor = made.options(**options).remote([os.path.abspath(entry) for entry in sys.path])
        try:
            self._reply(self.actor.__ray_ready__, timeout_s=start_timeout)
            problem = pickle.loads(self._reply(self.actor.handle, packed))
        except TimeoutError:
            self.kill()
            raise NoRoomError(_no_room(options, start_timeout)) from None
        except ActorUnavailableError as error:
            raise WorkerDiedError(_death(error)) from None
        except RayError as error:
            if isinstance(error, ActorDiedError) and not error.actor_init_failed:
                raise WorkerDiedError(_death(error)) from None
            raise EnvFaultError(f"an actor could not be started on Ray: {error}") from error
        if problem is not None:
            self.kill()
            raise problem
        _workers.add(self)

    def request(self, data: bytes, timeout_s: float | None) -> bytes:
        """Send a request, and wait for the reply."""
        try:
            return cast("bytes", self._reply(self.actor.handle, data, timeout_s=timeout_s))
        except RayError as error:
            raise WorkerDiedError(_death(error)) from None

    def is_alive(self) -> bool:
        """Tell whether it was neither killed nor cut off; that it died by itself is known only after a request."""
        return not self._killed and connection() == self._connection

    def kill(self) -> None:
        """End the actor at once."""
        if self.is_alive():
            with suppress(RayError, ValueError):
                ray.kill(self.actor, no_restart=True)
        self._killed = True

    def _reply(self, method: Any, *args: Any, timeout_s: float | None = None) -> Any:
        """Call a method of the actor, and wait for what it returns.

        It waits outside Ray: a thread that waits in ``ray.wait`` while the program disconnects may wait for ever, or
        connect again.
        """
        end = None if timeout_s is None else time.monotonic() + timeout_s
        future = None
        while connection() == self._connection:
            future = future or method.remote(*args).future()
            left = _LOOKING_S if end is None else min(_LOOKING_S, max(0.0, end - time.monotonic()))
            if concurrent.futures.wait([future], left).done:
                return future.result()
            if end is not None and time.monotonic() >= end:
                raise TimeoutError
        raise WorkerDiedError("was lost: the program has cut its connection to Ray")


@atexit.register
def _close_all() -> None:
    """At the end of the program, before Ray's own end, let all actors close their environments."""
    living = [worker.actor for worker in _workers if worker.is_alive()]
    concurrent.futures.wait([actor.close.remote().future() for actor in living], CLOSING_S + 1.0)


def _death(error: RayError) -> str:
    """Return how an actor died, as part of a sentence, without its identifiers and Ray's guesses at causes."""
    lines = str(error).splitlines()
    words = " ".join(line for line in lines[1:] if not line.startswith("\t")) or lines[0]
    return f"died on Ray: {' '.join(words.partition('Some common causes')[0].split())[:600].rstrip('. ')}"


def _no_room(options: Mapping[str, Any], seconds: float) -> str:
    return (
        f"Ray has not started an actor with {dict(options)} within {seconds:g} s; free in the cluster is "
        f"{cluster_resources(free=True)} of {cluster_resources()}. Ask for fewer or smaller actors (num_actors, "
        "num_cpus), or give Ray more time (start_timeout)"
    )
