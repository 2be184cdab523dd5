"""The backend ``ray``: environments in actors of a Ray cluster, many in each."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.vector import VectorEnv, VectorSetup
from gem_core.vector.remote import Link, Message, RemoteHost, worker_setup
from gem_ray.cluster import Lease, cluster_resources
from gem_ray.link import RayLink, Watches


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
    for name, number in (("num_cpus", num_cpus), ("num_gpus", num_gpus), ("memory", memory)):
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
    blob = worker_setup(setup, {})
    lease = Lease(address, init or {})
    lease.take()
    crew = Crew(blob, len(setup.ids), {name: value for name, value in options.items() if value is not None}, lease)
    return VectorEnv(setup, RayHost(setup, crew, min(len(setup.ids), num_actors or _places(num_cpus))))


class Crew:
    """Starts the actors of one vector environment.

    Args:
        setup: What environments are made from.
        slots: Number of slots.
        options: Of each actor, such as ``num_cpus``.
        lease: The right to use Ray.
    """

    def __init__(self, setup: bytes, slots: int, options: Mapping[str, Any], lease: Lease) -> None:
        self._setup = setup
        self._slots = slots
        self._options = options
        self._lease = lease
        self._watches = Watches(options.get("runtime_env"))
        weakref.finalize(self, lease.drop).atexit = False

    def new_link(self, on_messages: Callable[[Link, list[Message]], None], on_death: Callable[[Link], None]) -> RayLink:
        """Start an actor."""
        self._lease.take()
        return RayLink(self._setup, self._slots, self._options, self._watches, on_messages, on_death)

    def close(self) -> None:
        """End what is left when the actors are gone."""
        self._watches.close()
        self._lease.give_back()


class RayHost(RemoteHost):
    """Runs environments in actors, many in each, and replaces an actor that dies or has to be killed.

    Args:
        setup: What environments are made from.
        crew: Starts actors.
        actors: Number of them.
    """

    def __init__(self, setup: VectorSetup, crew: Crew, actors: int) -> None:
        super().__init__(setup, crew.new_link, actors)
        self._crew = crew

    def next_check(self, now: float) -> float | None:
        """Return in how many seconds the first command that runs is overdue, or a watch has to be heard again."""
        seconds = super().next_check(now)
        limit = self._setup.step_timeout
        if seconds is None or limit is None:
            return None
        far = any(isinstance(link, RayLink) and link.is_far for link in self._links)
        return min(seconds, max(0.02, limit / 8)) if far else seconds

    def renewed(self) -> RayHost:
        """Return a host without actors; see ``Host.renewed``."""
        super().renewed()
        return RayHost(self._setup, self._crew, len(self._links))

    def close(self) -> None:
        """End every actor, and a Ray that was started for them; their environments are closed first."""
        super().close()
        self._crew.close()


def _places(num_cpus: float) -> int:
    """Return how many actors there is room for now."""
    return max(1, int(cluster_resources(free=num_cpus > 0).get("CPU", 1) // (num_cpus or 1)))
