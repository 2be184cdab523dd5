"""``Lease``: the connection to a running Ray cluster, or to one started here, which ends with its last user."""

from __future__ import annotations

import atexit
import logging
import threading
import weakref
from collections.abc import Mapping
from typing import Any, Protocol

import ray

from gem_core.errors import ArgumentError, EnvFaultError

_lock = threading.RLock()
_users: set[Lease] = set()
_connected_here = False
"""Whether this module connected the process to Ray."""


class Closable(Protocol):
    """Something that has to end before the connection does."""

    def end(self) -> None:
        """End it at once."""


_open: weakref.WeakSet[Any] = weakref.WeakSet()


class Lease:
    """The right to use Ray; when the last is given back, a connection that was made for them is cut.

    A Ray that we started ends with it; a cluster that was there goes on, and so does a connection that the program
    made by itself.

    Args:
        address: See ``backend.actors``.
        init: More options of ``ray.init``.
    """

    def __init__(self, address: str | None, init: Mapping[str, Any]) -> None:
        if address is not None and address.startswith("ray://"):
            raise ArgumentError(
                f"address {address!r} is that of a Ray Client, which cannot stream results; run the program on a node "
                "of the cluster, as with 'ray job submit', and use address='auto'"
            )
        self._address = address
        self._init = dict(init)

    def take(self) -> None:
        """Connect to Ray, if this process is not connected.

        Raises:
            EnvFaultError: There is no Ray at the address, or none can be started.
        """
        global _connected_here
        with _lock:
            if not ray.is_initialized():
                _users.clear()
                _connect(self._address, self._init)
                _connected_here = True
            _users.add(self)

    def give_back(self) -> None:
        """Cut the connection, if it was made for leases and this is the last."""
        global _connected_here
        with _lock:
            if self not in _users:
                return
            _users.discard(self)
            if not _users and _connected_here:
                _connected_here = False
                _end_all()
                ray.shutdown()

    def drop(self) -> None:
        """Give it back without closing the connection: the garbage collector may call this anywhere."""
        _users.discard(self)


def end_at_exit(link: Closable) -> None:
    """End something before Ray ends with the process; it is held weakly."""
    _open.add(link)


def connection() -> tuple[str, str] | None:
    """Return what tells the present connection from any other; None without one."""
    if not ray.is_initialized():
        return None
    context = ray.get_runtime_context()
    return context.get_node_id(), context.get_job_id()


def cluster_resources(*, free: bool = False) -> dict[str, float]:
    """Return what the cluster has, or what of that is free."""
    asked: Any = ray.available_resources if free else ray.cluster_resources
    return dict(asked())


def _connect(address: str | None, init: dict[str, Any]) -> None:
    # Ray reports on itself at length; what it warns of is still said.
    options = {"log_to_driver": False, "logging_level": logging.ERROR, **init}
    try:
        if address is None:
            try:
                ray.init(address="auto", **_for_clients(options))
            except ConnectionError:
                address = "local"
        if address == "local":
            ray.init(address="local", **{"include_dashboard": False, **options})
        elif address is not None:
            ray.init(address=address, **_for_clients(options))
    except (ConnectionError, OSError, RuntimeError, ValueError, TimeoutError) as error:
        where = "no Ray could be started" if address == "local" else f"there is no Ray at address {address!r}"
        raise EnvFaultError(
            f"{where}: {error}. Start one by 'ray start --head', or use address='local' for one of our own"
        ) from error


def _for_clients(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of ``ray.init`` that a cluster that is there leaves to the programs that use it."""
    its_own = ("num_cpus", "num_gpus", "resources", "labels", "object_store_memory", "include_dashboard")
    return {name: value for name, value in options.items() if name not in its_own and not name.startswith("_")}


def _end_all() -> None:
    # Before Ray's own, as it is registered later: a thread that waits for an actor must not outlive the connection.
    while _open:
        _open.pop().end()


atexit.register(_end_all)
