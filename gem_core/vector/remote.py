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
from dataclasses import replace
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.closing import CLOSING_S
from gem_core.env.base import Env
from gem_core.errors import ArgumentError, GemError
from gem_core.making.layers import wrapper_targets
from gem_core.registry.lookup import registry
from gem_core.types import ResetResult, StepResult
from gem_core.vector.failures import Failure, WorkerFailureError
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
        self,
        slot: int,
        number: int,
        method: str,
        *args: Any,
        on: Worker | None = None,
        timeout_s: float | None = None,
    ) -> tuple[Any, Worker]:
        """Call a method of ``WorkerLoop`` in the worker of a slot.

        Args:
            slot: Number of the slot.
            number: Of the environment; a slot's former one may still be closing when the next is made.
            method: Name of the method.
            *args: Its arguments.
            on: The worker in which the slot's episode began; None takes the present worker, or starts one.
            timeout_s: Seconds that it may take, from when the worker turns to it.

        Returns:
            What the method returned, and the worker.

        Raises:
            WorkerFailureError: The method failed, or the worker did.
        """
        data = _packed_request(number, method, args)
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
                except (TimeoutError, WorkerDiedError) as error:
                    worker.kill()
                    place.worker = None
                    failure = Failure("died", f"its worker process {error}")
                    if isinstance(error, TimeoutError):
                        told = f"a step or reset took longer than step_timeout, {timeout_s:g} s"
                        failure = Failure("timeout", told)
                    raise WorkerFailureError(failure) from None
                except BaseException:
                    # Interrupted: its reply would be taken for that of the next request.
                    worker.kill()
                    place.worker = None
                    raise
        value = _unpack(reply)
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
                    reply = place.worker.request(_packed_request(-1, "close_all", ()), CLOSING_S + 1.0)
                    left.append(_unpack(reply))
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
        asked = not self.described
        value, self._worker = self._request("reset", *self._made_for, self._record(), seed, options, asked)
        result, described = value
        self.described = described or self.described
        return cast("ResetResult", result)

    def step(self, action: Any) -> StepResult:
        """Step the environment."""
        return cast("StepResult", self._request("step", action, on=self._worker)[0])

    def apply(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return ``function(env, *args)``, called in the worker; the environment is made there if need be."""
        value, worker = self._request("apply", *self._made_for, self._record(), function, args, on=self._worker)
        self._worker = self._worker or worker
        return value

    def draw_action(self, seed: int | None, agent: str | None) -> str:
        """Return a valid action; see ``EnvRunner.sample_random_action``."""
        return cast("str", self._request("sample_random_action", seed, agent, on=self._worker)[0])

    def close(self) -> None:
        """Close the environment, if its worker lives."""
        worker, self._worker = self._worker, None
        if worker is not None:
            try:
                self._pool.request(self._slot, self._number, "close", on=worker)
            except WorkerFailureError:
                return  # it has ended with its worker

    def _request(self, method: str, *args: Any, on: Worker | None = None) -> tuple[Any, Worker]:
        limit = self._pool.setup.step_timeout if method in ("reset", "step") else None
        return self._pool.request(self._slot, self._number, method, *args, on=on, timeout_s=limit)

    def _record(self) -> bytes | None:
        """Return the record of an id that the setup does not have, as one that a script registered."""
        env_id = self._made_for[0]
        if env_id is None or env_id in self._pool.setup.all_ids:
            return None
        record = self._pool.setup.record(env_id)
        return pack_by_value(record, [record.entry_point])


def _packed_request(number: int, method: str, args: tuple[Any, ...]) -> bytes:
    try:
        content = pickle.dumps(args, protocol=5)
    except Exception:  # noqa: BLE001 - an object's own pickling may raise anything
        try:
            content = bytes(cloudpickle.dumps(args))  # lambdas, and classes defined in a script
        except Exception as error:
            what = "its action" if method == "step" else "what it is made from"
            told = ArgumentError(f"{what} cannot be sent to another process:{why(error)}")
            raise WorkerFailureError(Failure("exception", str(told), told, permanent=method != "step")) from error
    return pickle.dumps((number, method, content), protocol=5)


def _unpack(reply: bytes) -> Any:
    try:
        return pickle.loads(reply)
    except Exception as error:  # noqa: BLE001 - as above
        return Failure("exception", f"its result cannot be read in another process:{why(error)}")


def why(error: Exception) -> str:
    """Return the kind and the text of an error of pickling."""
    return Failure.of(error, "").message.removeprefix(" raised")


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
