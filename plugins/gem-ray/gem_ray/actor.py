"""Ray actors: ``EnvActor`` with the environments of some slots, and ``NodeWatch``, which reads their command times."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple, cast

import ray

from gem_core.vector import CommandTimes, Worker


class Place(NamedTuple):
    """Where an actor runs.

    Args:
        node: Id of the node.
        times: Path of the file for ``CommandTimes``, on that node.
    """

    node: str
    times: str


class EnvActor:
    """A worker on Ray: many environments, and a streaming call that yields their results.

    Its two concurrency groups have one thread each, so that commands are done in the order in which they were sent.

    Args:
        setup: What environments are made from.
        path: ``sys.path`` of the program; what of it exists here is searched last.
    """

    def __init__(self, setup: bytes, path: list[str]) -> None:
        sys.path.extend(entry for entry in path if entry not in sys.path and os.path.exists(entry))
        file, self._times = tempfile.mkstemp(prefix="gem-times-")
        self._worker = Worker(setup, file)
        os.close(file)

    @ray.method(concurrency_group="commands", num_returns=0)
    def take(self, data: bytes) -> None:
        """Handle messages from the program."""
        self._worker.take(data)

    @ray.method(concurrency_group="results", num_returns="streaming")
    def give(self) -> Iterator[Place | bytes]:
        """Yield the place of this actor, then the worker's messages, until it is closed."""
        yield Place(ray.get_runtime_context().get_node_id(), self._times)
        yield from self._worker.given()

    @ray.method(concurrency_group="commands", num_returns=0)
    def close(self) -> None:
        """Close the environments, and end the streaming call."""
        self._worker.close()
        with suppress(OSError):  # usually it was opened, and its name removed
            os.unlink(self._times)


class NodeWatch:
    """Reports since when commands run in the workers of its node, even if these hang or are dead."""

    def __init__(self) -> None:
        self._times: dict[str, CommandTimes] = {}

    def running(self, path: str, slots: int) -> dict[int, float]:
        """Return the slots whose command runs, or ran when the worker died, and for how many seconds."""
        if path not in self._times:
            self._times[path] = open_times(path, slots)
        now = time.monotonic()
        return {slot: now - since for slot, since in self._times[path].running().items()}

    @ray.method(num_returns=0)
    def forget(self, path: str) -> None:
        """Forget a worker that is gone."""
        if self._times.pop(path, None) is None:
            with suppress(OSError):
                os.unlink(path)


def open_times(path: str, slots: int) -> CommandTimes:
    """Return what a worker of this machine notes; its file has no name any more then, so that nothing is left behind.

    Raises:
        OSError: It is not there.
    """
    file = os.open(path, os.O_RDWR)
    try:
        times = CommandTimes(slots, file)
        os.unlink(path)
    finally:
        os.close(file)
    return times


def actor_class(options: dict[str, Any]) -> Any:
    """Return ``EnvActor`` as Ray's, with options such as ``num_cpus``."""
    # Its types know no concurrency groups.
    made = cast("Any", ray).remote(
        max_restarts=0, max_task_retries=0, concurrency_groups={"commands": 1, "results": 1}
    )(EnvActor)
    return made.options(**options)
