"""``RemoteEnv``: an environment that lives in a worker, and ``WorkerPool``, which keeps the workers.

A worker is another process, or an actor of a plugin. It serves the environments of some slots, one request after
another. When it dies, or is killed since a request takes too long, the episodes in it end as errors: the one that was
asked ``"died"`` or ``"timeout"``, the others ``"collateral"``. The next reset starts another worker.
"""

from __future__ import annotations

import itertools
import logging
import pickle
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.closing import CLOSING_S
from gem_core.env.base import Env
from gem_core.errors import ArgumentError, GemError
from gem_core.failures import Failure, WorkerFailureError, shown_error
from gem_core.making.layers import wrapper_targets
from gem_core.types import ResetResult, StepResult
from gem_core.vector.setup import VectorSetup

logger = logging.getLogger("gem_core")


class WorkerDiedError(Exception):
    """The worker has ended; the text says how, as part of a sentence."""


class NoRoomError(GemError):
    """There is no room for another worker: its slots share a living one; if none lives, the run ends with this."""


class Worker(ABC):
    """The program's end of a worker, which runs a ``WorkerLoop``."""

    @abstractmethod
    def request(self, data: bytes, timeout_s: float | None) -> bytes:
        """Return the reply of ``WorkerLoop.handle`` to a request; called by one thread at a time.

        Raises:
            TimeoutError: It took longer than ``timeout_s``.
            WorkerDiedError: The worker has ended.
        """

    @abstractmethod
    def is_alive(self) -> bool:
        """Tell whether the worker is alive, as far as is known."""

    @abstractmethod
    def kill(self) -> None:
        """End the worker and every process that it started, at once; calling it again does nothing."""


class _Place:
    """One worker of a pool, and the requests that wait for it."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        """Held while a request is answered."""
        self.worker: Worker | None = None


class WorkerPool:
    """Starts workers when they are needed, and replaces dead ones.

    Args:
        setup: Arguments that environments are made from.
        start: Starts a worker from the pickled setup; it may raise ``NoRoomError``.
        count: Number of workers; slots are assigned to them in turn.

    Raises:
        ArgumentError: The setup cannot be pickled.
    """

    def __init__(self, setup: VectorSetup, start: Callable[[bytes], Worker], count: int) -> None:
        self.setup = setup
        self._start = start
        self._packed = _pack_setup(setup)
        self._places = [_Place() for _ in range(count)]
        """The place of each slot's worker, in turn; a place with no room for a worker gives way to a living one."""
        self._closed = False

    def make(self, slot: int, env_id: str | None, kwargs: Mapping[str, Any]) -> RemoteEnv:
        """Return the environment of a slot; its worker makes it at the first reset."""
        return RemoteEnv(self, slot, env_id, kwargs)

    def request(
        self, slot: int, on: Worker | None, timeout_s: float | None, method: str, *args: Any
    ) -> tuple[Any, Worker]:
        """Call a method of ``WorkerLoop`` in the worker of a slot.

        Args:
            slot: Number of the slot.
            on: The worker in which the slot's episode began; None takes the present worker, or starts one.
            timeout_s: Seconds that it may take, from when the worker turns to it.
            method: Name of the method.
            *args: Its arguments.

        Returns:
            What the method returned, and the worker.

        Raises:
            WorkerFailureError: The method failed, or the worker did.
        """
        try:
            data = pickle.dumps((method, args), protocol=5)
        except Exception:  # noqa: BLE001 - an object's own pickling may raise anything
            data = _pack_request(method, args)
        while True:
            place = self._places[slot % len(self._places)]
            with place.lock:
                if place is not self._places[slot % len(self._places)]:
                    continue  # the slot moved while it waited
                worker = self._worker(place, on)
                if worker is None:
                    continue
                try:
                    reply = worker.request(data, timeout_s)
                    break
                except BaseException as error:
                    # Also if it was interrupted: its reply would be taken for that of the next request.
                    worker.kill()
                    place.worker = None
                    if timeout_s is not None and isinstance(error, TimeoutError):
                        raise WorkerFailureError(Failure.timeout(timeout_s)) from None
                    if isinstance(error, WorkerDiedError):
                        raise WorkerFailureError(Failure("died", f"its worker process {error}")) from None
                    raise
        try:
            value = pickle.loads(reply)
        except Exception as error:  # noqa: BLE001 - an object's own unpickling may raise anything
            value = Failure("exception", f"its result cannot be read in another process: {shown_error(error)}")
        if isinstance(value, Failure):
            raise WorkerFailureError(value)
        return value, worker

    def _worker(self, place: _Place, on: Worker | None) -> Worker | None:
        """Return the worker at a place; start one if there is none, or it is dead. None if the slots moved."""
        if self._closed:
            raise WorkerFailureError(Failure("died", "the vector environment was closed before it answered"))
        if place.worker is not None and not place.worker.is_alive():
            place.worker.kill()
            place.worker = None
        if on is not None and on is not place.worker:
            raise WorkerFailureError(Failure("collateral", "its worker was lost with another environment"))
        if place.worker is None:
            try:
                place.worker = self._start(self._packed)
            except WorkerDiedError as death:
                raise WorkerFailureError(Failure("died", f"its worker process {death}")) from None
            except GemError as error:  # none can be started
                if isinstance(error, NoRoomError) and self._move(place):
                    logger.warning("gem: a worker's slots move to another, which they share: %s", error)
                    return None
                raise WorkerFailureError(Failure("exception", str(error), error, permanent=True)) from error
            if self._closed:  # meanwhile
                place.worker.kill()
        return place.worker

    def _move(self, place: _Place) -> bool:
        """Let the slots of a place share the worker of the least used place that has one; tell whether there is one."""
        living = [each for each in self._places if each.worker is not None and each.worker.is_alive()]
        if living:
            shared = min(living, key=living.count)
            for index, each in enumerate(self._places):
                if each is place:
                    self._places[index] = shared
        return bool(living)

    def close(self) -> int:
        """End all workers at once; each closes its environments first. Return how many environments had not closed."""
        self._closed = True
        left: list[int] = []

        def end(place: _Place) -> None:
            # A worker that is busy with a request is not asked to close: it would not read the message.
            if place.worker is None:
                return
            if place.lock.acquire(timeout=1.0):
                try:
                    reply = place.worker.request(pickle.dumps(("close", ())), CLOSING_S + 1.0)
                    left.append(pickle.loads(reply))
                except (TimeoutError, WorkerDiedError):
                    left.append(1)
                finally:
                    place.lock.release()
            else:
                left.append(1)
            place.worker.kill()

        threads = [threading.Thread(target=end, args=(place,), daemon=True) for place in set(self._places)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return sum(left)


_numbers = itertools.count()
"""Of the environments in workers."""


class RemoteEnv(Env):
    """An environment that lives in a worker: its methods are requests, which block the calling thread.

    Args:
        pool: The workers.
        slot: Number of the slot, which tells the worker.
        made_id: Id of the environment.
        made_kwargs: Its keyword arguments.
    """

    concurrency = "thread"

    def __init__(self, pool: WorkerPool, slot: int, made_id: str | None, made_kwargs: Mapping[str, Any]) -> None:
        super().__init__()
        self._pool, self._slot, self._made_for = pool, slot, (made_id, dict(made_kwargs))
        self._number = next(_numbers)
        self._worker: Worker | None = None
        self.described: dict[str, Any] = {}
        """``id``, ``kwargs`` and ``wrappers`` of the environment, once it was reset."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin an episode; the worker makes the environment unless it has it."""
        limit, describe = self._pool.setup.step_timeout, not self.described
        made_for = *self._made_for, self._record()
        value, self._worker = self._request(None, limit, "reset", *made_for, seed, options, describe)
        result, described = value
        self.described = described or self.described
        return cast("ResetResult", result)

    def step(self, action: Any) -> StepResult:
        """Step the environment."""
        pool = self._pool
        worker, limit = self._worker, pool.setup.step_timeout
        result, _ = pool.request(self._slot, worker, limit, "step", self._number, action)
        return cast("StepResult", result)

    def apply(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return ``function(env, *args)``, called in the worker; the environment is made there if need be."""
        made_for = *self._made_for, self._record()
        value, worker = self._request(self._worker, None, "apply", *made_for, function, args)
        self._worker = self._worker or worker
        return value

    def draw_action(self, seed: int | None, agent: str | None) -> str:
        """Return a valid action; see ``EnvRunner.sample_random_action``."""
        return cast("str", self._request(self._worker, None, "sample_random_action", seed, agent)[0])

    def close(self) -> None:
        """Close the environment, if its worker lives."""
        worker, self._worker = self._worker, None
        if worker is not None:
            with suppress(WorkerFailureError):  # it has ended with its worker
                self._request(worker, None, "close_env")

    def _request(self, on: Worker | None, timeout_s: float | None, method: str, *args: Any) -> tuple[Any, Worker]:
        return self._pool.request(self._slot, on, timeout_s, method, self._number, *args)

    def _record(self) -> bytes | None:
        """Return the record of an id that the setup does not have, as one that a script registered."""
        env_id = self._made_for[0]
        if env_id is None or env_id in self._pool.setup.records:
            return None
        record = self._pool.setup.record(env_id)
        return pack_by_value(record, [record.entry_point])


def _pack_request(method: str, args: tuple[Any, ...]) -> bytes:
    """Pickle a request with lambdas, or classes that are defined in a script."""
    try:
        return cast("bytes", cloudpickle.dumps((method, args)))
    except Exception as error:
        stepping = method == "step"
        what = "its action" if stepping else "what it is made from"
        told = ArgumentError(f"{what} cannot be sent to another process: {shown_error(error)}")
        raise WorkerFailureError(Failure("exception", str(told), told, permanent=not stepping)) from error


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
    wrappers = setup.wrappers if isinstance(setup.wrappers, str | Mapping) else list(setup.wrappers)
    sent = replace(setup, plan=None, wrappers=wrappers, kwargs=dict(setup.kwargs))
    entry_points = [record.entry_point for record in setup.records.values()]
    return pack_by_value(sent, [*entry_points, *wrapper_targets(wrappers)])
