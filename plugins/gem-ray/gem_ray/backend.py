"""The backend ``ray``: environments in actors of a Ray cluster, many in each."""

from __future__ import annotations

import math
import weakref
from collections.abc import Mapping
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.vector import VectorEnv, VectorSetup, WorkerPool
from gem_ray.cluster import Lease, room
from gem_ray.worker import RayWorker

_START_S, _PREPARING_S = 30.0, 600.0
"""Seconds that an actor may take to start; the second for the first one, if Ray prepares a ``runtime_env``."""


def actors(
    setup: VectorSetup,
    *,
    num_actors: int | None = None,
    num_cpus: float = 1,
    num_gpus: float | None = None,
    memory: int | None = None,
    resources: Mapping[str, float] | None = None,
    runtime_env: Mapping[str, Any] | None = None,
    scheduling_strategy: Any = "SPREAD",
    start_timeout: float | None = None,
    address: str | None = None,
    init: Mapping[str, Any] | None = None,
) -> VectorEnv:
    """Step environments in actors of a Ray cluster, many in each.

    Args:
        setup: See ``make_vec``.
        num_actors: Number of actors, which the slots take in turn; by default as many as free CPUs of the cluster
            allow, and no more than there are slots.
        num_cpus: CPUs that each actor takes for its own; 0 for none.
        num_gpus: The same for GPUs.
        memory: Bytes that Ray sets aside for each actor.
        resources: Other resources that each actor takes, by name.
        runtime_env: What Ray prepares where an actor runs, as in ``{"pip": ["gem-ray"]}``.
        scheduling_strategy: Where Ray places actors; by default they are spread over the nodes.
        start_timeout: Seconds that an actor may take to start, not counting imports; then the slots of a place without
            an actor move to the actors that live, or, if none does, the run ends with an error. By default 30, and 600
            for the first actor with a ``runtime_env``.
        address: Of the cluster: ``"auto"`` for the one that this machine belongs to, ``"local"`` for one of our own,
            which ends with the last vector environment that uses it. None takes the connection that the program has;
            else the cluster that this machine belongs to; else one of our own.
        init: More options of ``ray.init``, for a connection that we make.

    Raises:
        ArgumentError: A value that cannot be.
        EnvFaultError: There is no Ray at the address.
    """
    if num_actors is not None and (type(num_actors) is not int or num_actors < 1):
        raise ArgumentError(f"num_actors must be a positive whole number, not {num_actors!r}")
    numbers = {"num_cpus": num_cpus, "num_gpus": num_gpus, "memory": memory, "start_timeout": start_timeout}
    for name, number in numbers.items():
        if number is not None and not (isinstance(number, int | float) and 0 <= number < math.inf):
            raise ArgumentError(f"{name} must be a number from 0 up, not {number!r}")
    options = {
        "num_cpus": num_cpus,
        "num_gpus": num_gpus,
        "memory": memory,
        "resources": None if resources is None else dict(resources),
        "runtime_env": None if runtime_env is None else dict(runtime_env),
        "scheduling_strategy": scheduling_strategy,
    }
    given = {name: value for name, value in options.items() if value is not None}
    lease = Lease(address, init or {})
    count = min(len(setup.slots), num_actors or room(num_cpus, len(setup.slots)))
    return VectorEnv(setup, pool=RayPool(setup, count, lease, given, start_timeout))


class RayPool(WorkerPool):
    """Workers in actors, and the connection to Ray that they need.

    Args:
        setup: What environments are made from.
        count: Number of actors.
        lease: The right to use Ray.
        options: Of each actor, such as ``num_cpus``.
        start_timeout: See ``actors``.
    """

    def __init__(
        self, setup: VectorSetup, count: int, lease: Lease, options: Mapping[str, Any], start_timeout: float | None
    ) -> None:
        later = _START_S if start_timeout is None else start_timeout
        limit = _PREPARING_S if start_timeout is None and "runtime_env" in options else later

        def start(packed: bytes) -> RayWorker:
            nonlocal limit
            lease.check()
            worker = RayWorker(packed, options, limit)
            limit = later
            return worker

        super().__init__(setup, start, count)
        self._lease = lease
        weakref.finalize(self, lease.drop).atexit = False

    def close(self) -> int:
        """End all actors, and a connection that was made for them; see ``WorkerPool.close``."""
        left = super().close()
        self._lease.give_back()
        return left
