"""``Things``: what one machine has made on an engine, and how all of it is removed, whatever happens."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import docker.errors

from gem_core.errors import GemError
from gem_terminal.backends.docker.engine import FAILURES

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Engine

_GONE = ("is already in progress", "no such container", "not found")


class Things:
    """What was made, by name; noted before it is made, so that nothing is lost between the two.

    Args:
        engine: The engine.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._pid = os.getpid()
        self._lock = threading.Lock()
        self.containers: list[str] = []
        self.images: list[str] = []
        self.volumes: list[str] = []
        self.networks: list[str] = []

    @property
    def is_foreign(self) -> bool:
        """Whether this is a child that was forked, whose parent all this belongs to."""
        return os.getpid() != self._pid

    def remove(self) -> bool:
        """Remove all of it; never raises, and returns whether nothing is left that could not be removed now."""
        if self.is_foreign:
            return True
        with self._lock:
            client = self._engine
            self.containers = _each(reversed(self.containers), lambda name: _remove_container(client, name))
            self.images = _each(self.images, lambda name: client.client.discard_image(name, force=True))
            self.volumes = _each(self.volumes, lambda name: client.client.remove_volume(name, force=True))
            self.networks = _each(self.networks, lambda name: client.client.remove_network(name))
            return not (self.containers or self.images or self.volumes or self.networks)

    def remove_containers(self, names: Sequence[str]) -> None:
        """Remove some of the containers."""
        for name in names:
            if not _each([name], lambda name: _remove_container(self._engine, name)) and name in self.containers:
                self.containers.remove(name)


def _remove_container(engine: Engine, name: str) -> None:
    engine.client.remove_container(name, v=True, force=True)


def _each(names: Iterable[str], remove: Callable[[str], object]) -> list[str]:
    """Remove things one by one; return those that are still there, as far as is known."""
    left = []
    for name in list(names):
        try:
            remove(name)
        except docker.errors.NotFound:
            continue
        except docker.errors.APIError as error:
            if not any(words in str(error).lower() for words in _GONE):
                left.append(name)
        except (GemError, *FAILURES):
            left.append(name)
    return left
