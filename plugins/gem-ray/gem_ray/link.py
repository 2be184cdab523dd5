"""``RayLink``: a Ray actor with environments, seen from the process that uses it."""

from __future__ import annotations

import logging
import sys
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, cast

import ray
from ray.exceptions import ActorDiedError, ActorUnavailableError, RayError

from gem_core.errors import EnvFaultError
from gem_core.vector import Failure
from gem_core.vector.remote import Link, Message, weakly
from gem_core.vector.wire import from_bytes, to_bytes
from gem_core.vector.worker import SharedTimes
from gem_ray.actor import Place, Watch, actor_class, opened
from gem_ray.cluster import cluster_resources, connection, end_at_exit

logger = logging.getLogger("gem_ray")

_CLOSING_S = 6.0
"""How long an actor may take to close its environments."""

_ENDING_S = 5.0
"""How long Ray may take to tell that an actor that was killed is gone."""

_STARTING_S = 15.0
"""After so long without an actor, it is said what it may be waiting for."""

_LOOKING_S = 1.0
"""How often a thread that waits for an actor looks whether the program is still connected to Ray."""

_ASKING_S = 10.0
"""How long a watch may take to say what ran in an actor that died; it may have to be started first."""

_REACHING_S = 3.0
"""The same where the actor cannot be reached: most likely its node cannot."""


class Watches:
    """One ``Watch`` for each node other than ours, started when it is first needed.

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
                made = ray.remote(num_cpus=0, max_restarts=0)(Watch)
                self._by_node[node] = made.options(scheduling_strategy=there, **self._options).remote()
            return self._by_node[node]

    def forget(self, place: Place) -> None:
        """Let the watch of a node, if there is one, let go of a worker."""
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


class RayLink(Link):
    """An actor with environments.

    Since when its commands run is read from a file that it shares: here, where it lives on the node of this process,
    else by a ``Watch`` on its own. Either can be read when the actor hangs, and when it is dead.

    Args:
        setup: What its environments are made from, or a reference to it.
        slots: Number of slots.
        options: Of the actor, such as ``num_cpus``.
        watches: Those of other nodes.
        on_messages: See ``Link``.
        on_death: See ``Link``.
    """

    def __init__(
        self,
        setup: Any,
        slots: int,
        options: Mapping[str, Any],
        watches: Watches,
        on_messages: Callable[[Link, list[Message]], None],
        on_death: Callable[[Link], None],
    ) -> None:
        self._slots = slots
        self._watches = watches
        self._lock = threading.Lock()
        self._sent: dict[int, float] = {}
        """Slots whose command has no outcome yet, in order, and when it was sent."""
        self._here: SharedTimes | None = None
        self._there: Any = None
        self._asked: tuple[float, Any] | None = None
        """When the watch was asked last, and for what."""
        self._seen: tuple[float, dict[int, float]] = (0.0, {})
        """When the watch was asked for what it said last, and that."""
        self._reason: BaseException | None = None
        self._over = self._buried = False
        self._on_messages, self._on_death = weakly(on_messages), weakly(on_death)
        self.place: Place | None = None
        """Where it lives; None until it has started."""
        self.actor: Any = actor_class(dict(options)).remote(setup, slots, [entry for entry in sys.path if entry])
        stream = self.actor.say.remote()
        self._ended = weakref.finalize(self, kill, self.actor)
        self._ended.atexit = False  # Ray ends before that; see end_at_exit
        self._reading = threading.Thread(
            target=_read,
            args=(weakref.ref(self), stream, self._on_messages),
            name="gem-ray",
            daemon=True,
        )
        self._reading.start()
        end_at_exit(self)

    @property
    def is_far(self) -> bool:
        """Whether a watch has to be asked for what runs in it: an answer is there when one looks again."""
        return self._there is not None

    def send(self, messages: list[Message]) -> None:
        """Hand messages to the actor without waiting for it.

        Raises:
            EnvFaultError: The program has called ``ray.shutdown``.
        """
        now = time.monotonic()
        with self._lock:
            self._sent.update((message[1], now) for message in messages if message[0] == "do")
        if self._ended.alive and not tell(self.actor.take, to_bytes(messages)):
            # Its own thread may not find out: Ray lets those wait for ever that wait while the program disconnects.
            raise EnvFaultError("the program has cut its connection to Ray; make the vector environment anew")

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs, or ran when it died, and since when."""
        if self._here is not None:
            return self._here.present()
        place = self.place
        if place is None:
            return {}
        if self._there is None:
            # Its file cannot be read: the first that has no outcome is the one that runs, or behind it.
            with self._lock:
                return dict(list(self._sent.items())[:1])
        self._ask(place)
        asked, seen = self._seen
        with self._lock:
            # What was seen may be the command before the present one.
            return {slot: since for slot, since in seen.items() if self._sent.get(slot, asked) < asked}

    def death(self) -> str:
        """Say how it died."""
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
        """Note where the actor lives."""
        if place.node == ray.get_runtime_context().get_node_id():
            with suppress(OSError):  # it may have a file system of its own
                self._here = opened(place.times, self._slots)
        else:
            self._there = self._watches.on(place.node)
        self.place = place
        if self._there is not None:
            self._ask(place)

    def finished(self, messages: list[Message]) -> None:
        """Note which commands have an outcome."""
        with self._lock:
            for message in messages:
                if message[0] == "done":
                    self._sent.pop(message[1], None)

    def bury(self, reason: BaseException | None) -> None:
        """Tell, once, that there will be no more of it."""
        with self._lock:
            if self._buried:
                return
            self._buried = True
        told, died = self._on_messages(), self._on_death()
        if told is not None and died is not None:
            if last := self._ended_by(reason):
                told(self, last)
            died(self)

    def _ended_by(self, reason: BaseException | None) -> list[Message]:
        """Note how it ended, and what ran in it; return what it would have said, if it could."""
        self._reason, self._over = reason, reason is not None
        if self.place is not None and self._there is not None:
            self._seen = (float("inf"), self._last_seen(self.place))
        self.kill()  # it may be out of reach, or unable to work, and live
        if self.place is None and reason is not None and _is_hopeless(reason):
            message = f"an actor could not be started on Ray: {reason}"
            return [("broken", Failure("exception", message, EnvFaultError(message), hopeless=True))]
        return []

    # Its own matters.

    def _ask(self, place: Place) -> None:
        """Take what the watch has said, and ask it anew."""
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
                    self._seen = when, {slot: now - seconds for slot, seconds in ray.get(answer).items()}
                except RayError:
                    self._there = None
                    return
            with suppress(Exception):  # as in tell()
                self._asked = now, self._there.running.remote(place.times, self._slots)

    def _last_seen(self, place: Place) -> dict[int, float]:
        limit = _REACHING_S if isinstance(self._reason, ActorUnavailableError) else _ASKING_S
        try:
            ran = ray.get(self._there.running.remote(place.times, self._slots), timeout=limit)
        except Exception:  # noqa: BLE001 - Ray raises one of its own, or a bare one
            # Its whole node is gone, and what ran there with it: none did it, and the first has to stand for all.
            with self._lock:
                return dict(list(self._sent.items())[:1])
        now = time.monotonic()
        return {slot: now - seconds for slot, seconds in ran.items()}


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


def _read(
    link_of: weakref.ref[RayLink],
    stream: Any,
    on_messages: Callable[[], Callable[[Link, list[Message]], None] | None],
) -> None:
    reason = _converse(link_of, stream, on_messages)
    if (link := link_of()) is not None:
        link.bury(reason)


def _converse(
    link_of: weakref.ref[RayLink],
    stream: Any,
    on_messages: Callable[[], Callable[[Link, list[Message]], None] | None],
) -> BaseException | None:
    """Hand on what an actor says until it ends; return what ended it, None if it was asked to."""
    try:
        ours = connection()
        if not ray.wait([stream], timeout=_STARTING_S)[0] and connection() == ours:
            logger.warning("gem-ray: an actor has not started yet; %s", _resources())
        # Never to wait for long: Ray would start anew for who waits while the program disconnects.
        while connection() == ours:
            if not ray.wait([stream], timeout=_LOOKING_S)[0]:
                continue
            said = from_bytes(ray.get(next(stream)))
            link, told = link_of(), on_messages()
            if link is None or told is None:
                return None
            if said and said[0][0] == "place":
                link.started(said[0][1])
            else:
                link.finished(said)
                told(link, said)
            del link, told, said
        return ConnectionError("the program has cut its connection to Ray")
    except StopIteration:
        return None
    except (RayError, ConnectionError, ValueError) as error:
        return cast("BaseException", error)


def _is_hopeless(reason: BaseException) -> bool:
    if isinstance(reason, ActorDiedError):
        return reason.actor_init_failed
    return isinstance(reason, RayError) and not isinstance(reason, ActorUnavailableError)


def _resources() -> str:
    try:
        return f"the cluster has {cluster_resources()}, and free of that {cluster_resources(free=True)}"
    except (RayError, ConnectionError):
        return "the cluster does not answer"
