"""``Lease``: the connection to a running Ray cluster, or to one started here, which ends with its last user."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from typing import Any

import ray

from gem_core.errors import ArgumentError, EnvFaultError

_FREEING_S = 2.0
"""Seconds that Ray may take to count as free what an actor held that has ended."""

_lock = threading.Lock()
_users: set[Lease] = set()
_made_here: tuple[str, str] | None = None
"""The last connection that this module made."""


class Lease:
    """The right to use a connection to Ray, which is made if this process has none.

    When the last lease is given back, a connection that was made for it is cut. A Ray that we started ends with it; a
    cluster that was there goes on, and so does a connection that the program made by itself.

    Args:
        address: See ``backend.actors``.
        init: More options of ``ray.init``.

    Raises:
        ArgumentError: The address is that of a Ray Client.
        EnvFaultError: There is no Ray at the address, or none can be started.
    """

    def __init__(self, address: str | None, init: Mapping[str, Any]) -> None:
        global _made_here
        if address is not None and address.startswith("ray://"):
            raise ArgumentError(
                f"address must be that of a cluster, not of a Ray Client, {address!r}; run the program on a node of "
                "the cluster, as with 'ray job submit', and use address='auto'"
            )
        with _lock:
            if not ray.is_initialized():
                _connect(address, dict(init))
                _made_here = connection()
            self._connection = connection()
            _users.add(self)

    def check(self) -> None:
        """Refuse to go on with another connection, or none.

        Raises:
            EnvFaultError: The program has called ``ray.shutdown``.
        """
        if connection() != self._connection:
            raise EnvFaultError("the program has cut its connection to Ray; make the vector environment anew")

    def give_back(self) -> None:
        """Cut the connection, if it was made for leases and this is the last."""
        with _lock:
            self.drop()
            shared = any(each._connection == self._connection for each in list(_users))
            if not shared and self._connection == connection() == _made_here:
                ray.shutdown()

    def drop(self) -> None:
        """Give it back without cutting the connection: the garbage collector may call this anywhere."""
        _users.discard(self)


def connection() -> tuple[str, str] | None:
    """Return what tells the present connection from any other; None if there is none."""
    if not ray.is_initialized():
        return None
    context = ray.get_runtime_context()
    return context.get_node_id(), context.get_job_id()


def room(num_cpus: float, most: int) -> int:
    """Return for how many actors there are free CPUs, from 1 to ``most``.

    What holds them may have ended just now, and Ray not know it yet: if there are too few, it looks again for a while.
    """

    def fitting(resources: dict[str, float]) -> int:
        return max(1, min(most, int(resources.get("CPU", 1) // (num_cpus or 1))))

    expected = count = fitting(cluster_resources())
    end = time.monotonic() + _FREEING_S
    while num_cpus and (count := fitting(cluster_resources(free=True))) < expected and time.monotonic() < end:
        time.sleep(0.05)
    return count


def cluster_resources(*, free: bool = False) -> dict[str, float]:
    """Return what the cluster has, or what of that is free."""
    asked: Any = ray.available_resources if free else ray.cluster_resources  # without types
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
