"""``RayLink``: a Ray actor with environments, seen from the process that uses it."""

from __future__ import annotations

import logging
import sys
import threading
import time
import weakref
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, cast

import ray
from ray.exceptions import ActorDiedError, ActorUnavailableError, RayError

from gem_core.errors import EnvFaultError
from gem_core.vector import CommandTimes, RemoteExecutor, Running, WorkerLink
from gem_ray.actor import NodeWatch, Place, actor_class, open_times
from gem_ray.cluster import cluster_resources, connection, end_at_exit

logger = logging.getLogger("gem_ray")

_CLOSING_S = 6.0
"""How long an actor may take to close its environments."""

_ENDING_S = 5.0
"""Seconds that Ray may take to report the end of a killed actor."""

_STARTING_S = 15.0
"""Seconds without an actor after which a warning says what it may be waiting for."""

_LOOKING_S = 1.0
"""How often a thread that waits for an actor looks whether the program is still connected to Ray."""

_ASKING_S = 10.0
"""How long a watch may take to say what ran in an actor that died; it may have to be started first."""

_REACHING_S = 3.0
"""The same where the actor cannot be reached: most likely its node cannot."""


class Watches:
    """One ``NodeWatch`` for each node other than ours, started when it is first needed.

    Args:
        runtime_env: As that of the actors.
    """

    def __init__(self, runtime_env: Mapping[str, Any] | None) -> None:
        self._options: dict[str, Any] = {} if runtime_env is None else {"runtime_env": dict(runtime_env)}
        self._lock = threading.Lock()
        self._by_node: dict[str, Any] = {}

    def on(self, node: str) -> Any:
        """Return the watch of a node."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        with self._lock:
            if node not in self._by_node:
                there = NodeAffinitySchedulingStrategy(node, soft=False)
                made = ray.remote(num_cpus=0, max_restarts=0)(NodeWatch)
                self._by_node[node] = made.options(scheduling_strategy=there, **self._options).remote()
            return self._by_node[node]

    def forget(self, place: Place) -> None:
        """Make the watch of a node, if there is one, forget a worker."""
        with self._lock:
            watch = self._by_node.get(place.node)
        if watch is not None:
            tell(watch.forget, place.times)

    def close(self) -> None:
        """End them all."""
        with self._lock:
            watches, self._by_node = list(self._by_node.values()), {}
        for watch in watches:
            kill(watch)


class RayLink(WorkerLink):
    """An actor with environments.

    Since when its commands run is read from a file that it shares: here, where it lives on the node of this process,
    else by a ``NodeWatch`` on its own. Either can be read when the actor hangs, and when it is dead.

    Args:
        executor: Whose worker it is.
        slots: Number of slots.
        options: Of the actor, such as ``num_cpus``.
        watches: Those of other nodes.
    """

    def __init__(self, executor: RemoteExecutor, slots: int, options: Mapping[str, Any], watches: Watches) -> None:
        super().__init__(executor)
        self._slots = slots
        self._watches = watches
        self._lock = threading.Lock()
        self._here: CommandTimes | None = None
        self._there: Any = None
        self._asked: tuple[float, Any] | None = None
        """When the watch was asked last, and for what."""
        self._seen = Running(0.0, {})
        """What the watch has said last, as of when it was asked."""
        self._reason: BaseException | None = None
        self._over = self._buried = False
        self.place: Place | None = None
        """Where it lives; None until it has started."""
        self.actor: Any = actor_class(dict(options)).remote(executor.packed, [each for each in sys.path if each])
        stream = self.actor.give.remote()
        self._ended = weakref.finalize(self, kill, self.actor)
        self._ended.atexit = False  # Ray ends before that; see end_at_exit
        self._reading = threading.Thread(target=_read, args=(weakref.ref(self), stream), name="gem-ray", daemon=True)
        self._reading.start()
        end_at_exit(self)

    def send(self, data: bytes) -> None:
        """Send bytes to the actor without waiting for it.

        Raises:
            EnvFaultError: The program has called ``ray.shutdown``.
        """
        if self._ended.alive and not tell(self.actor.take, data):
            # Its own thread may not find out: Ray lets those wait for ever that wait while the program disconnects.
            raise EnvFaultError("the program has cut its connection to Ray; make the vector environment anew")

    def running(self) -> Running | None:
        """Return what runs, or ran when it died; None if that cannot be read."""
        if self._here is not None:
            return Running(time.monotonic(), self._here.running())
        if self.place is None:
            return Running(time.monotonic(), {})
        if self._there is not None:
            self._ask(self.place)
        return None if self._there is None else self._seen

    def death(self) -> str:
        """Return how it died, as part of a sentence."""
        if self._reason is None:
            return "ended on Ray"
        lines = str(self._reason).splitlines()
        words = " ".join(line for line in lines[1:] if not line.startswith("\t")) or lines[0]
        # What Ray guesses at besides is long.
        return f"died on Ray: {' '.join(words.partition('Some common causes')[0].split())[:600].rstrip('. ')}"

    def kill(self) -> None:
        """End the actor at once."""
        if self._ended.detach() is not None:  # called, it would do nothing while the interpreter exits
            kill(self.actor)
        if self.place is not None:
            self._watches.forget(self.place)

    def close(self) -> None:
        """Let the actor close its environments, and end it."""
        if self.place is not None and self._ended.alive and self._reading.is_alive():
            tell(self.actor.close)
            self._reading.join(_CLOSING_S)
        self.end()

    def end(self) -> None:
        """End the actor, and wait until that is so."""
        self.kill()
        if threading.current_thread() is not self._reading:
            self._reading.join(_ENDING_S)
        if not self._over and ray.is_initialized():
            with suppress(Exception):  # an actor that is gone answers with an error of one kind or another
                ray.get(self.actor.__ray_ready__.remote(), timeout=_ENDING_S)
        self._over = True

    # What the thread that reads tells.

    def started(self, place: Place) -> None:
        """Record where the actor lives."""
        if place.node == ray.get_runtime_context().get_node_id():
            with suppress(OSError):  # it may have a file system of its own
                self._here = open_times(place.times, self._slots)
        else:
            self._there = self._watches.on(place.node)
        self.place = place
        if self._there is not None:
            self._ask(place)

    def bury(self, reason: BaseException | None) -> None:
        """Report, once, the end of the actor."""
        with self._lock:
            if self._buried:
                return
            self._buried = True
        self._reason, self._over = reason, reason is not None
        if self.place is not None and self._there is not None:
            self._see_last(self.place)
        self.kill()  # it may be out of reach, or unable to work, and live
        if self.place is None and reason is not None and _is_permanent(reason):
            self.died(EnvFaultError(f"an actor could not be started on Ray: {reason}"))
        else:
            self.died()

    # Command times.

    def _ask(self, place: Place) -> None:
        """Read the answer of the watch, and send the next request."""
        with self._lock:
            if self._reason is not None or not ray.is_initialized():
                return
            now = time.monotonic()
            if self._asked is not None:
                when, answer = self._asked
                if not ray.wait([answer], timeout=0)[0]:
                    return
                self._asked = None
                try:
                    self._seen = Running(when, {slot: now - seconds for slot, seconds in ray.get(answer).items()})
                except RayError:
                    self._there = None
                    return
            with suppress(Exception):  # as in tell()
                self._asked = now, self._there.running.remote(place.times, self._slots)

    def _see_last(self, place: Place) -> None:
        """Ask the watch what ran in an actor that is dead."""
        limit = _REACHING_S if isinstance(self._reason, ActorUnavailableError) else _ASKING_S
        try:
            ran = ray.get(self._there.running.remote(place.times, self._slots), timeout=limit)
        except Exception:  # noqa: BLE001 - Ray raises one of its own, or a bare one
            self._there = None  # its whole node is gone, and what ran there with it
            return
        now = time.monotonic()
        self._seen = Running(now, {slot: now - seconds for slot, seconds in ran.items()})


def tell(method: Any, *args: Any) -> bool:
    """Call a method of an actor without waiting for it; return whether there is one, dead or alive."""
    if ray.is_initialized():
        with suppress(Exception):  # Ray raises a bare one for an actor that it does not know any more
            method.remote(*args)
            return True
    return False


def kill(actor: Any) -> None:
    """End an actor at once."""
    if ray.is_initialized():
        with suppress(RayError, ValueError):
            ray.kill(actor, no_restart=True)


def _read(link_of: weakref.ref[RayLink], stream: Any) -> None:
    reason = _pass_on(link_of, stream)
    if (link := link_of()) is not None:
        link.bury(reason)


def _pass_on(link_of: weakref.ref[RayLink], stream: Any) -> BaseException | None:
    """Pass on the actor's messages until it ends; return the exception that ended it, None if it was closed."""
    try:
        ours = connection()
        if not ray.wait([stream], timeout=_STARTING_S)[0] and connection() == ours:
            logger.warning("gem-ray: an actor has not started yet; %s", _resources())
        # Wait only briefly: Ray would start again for a thread that waits while the program disconnects.
        while connection() == ours:
            if not ray.wait([stream], timeout=_LOOKING_S)[0]:
                continue
            given = ray.get(next(stream))
            link = link_of()
            if link is None:
                return None
            if isinstance(given, Place):
                link.started(given)
            else:
                link.received(given)
            del link, given
        return ConnectionError("the program has cut its connection to Ray")
    except StopIteration:
        return None
    except (RayError, ConnectionError, ValueError) as error:
        return cast("BaseException", error)


def _is_permanent(reason: BaseException) -> bool:
    if isinstance(reason, ActorDiedError):
        return reason.actor_init_failed
    return isinstance(reason, RayError) and not isinstance(reason, ActorUnavailableError)


def _resources() -> str:
    try:
        return f"the cluster has {cluster_resources()}, and free of that {cluster_resources(free=True)}"
    except (RayError, ConnectionError):
        return "the cluster does not answer"
