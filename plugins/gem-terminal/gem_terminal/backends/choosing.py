"""Which backend runs the tasks: Docker's, shared by all environments of a process, or an object of the user's."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gem_core.errors import ArgumentError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend

_lock = threading.Lock()
_made: dict[tuple[tuple[str, str], ...], Backend] = {}


def shared_backend(choice: str | Backend = "docker", build_args: Mapping[str, str] | None = None) -> Backend:
    """Return a backend that can be used here.

    Args:
        choice: ``"docker"`` for Docker or Podman, or an object, which is returned as it is.
        build_args: Arguments for the build of images.

    Raises:
        ArgumentError: There is no backend of that name.
        EngineError: No engine answers; says how to start one.
    """
    if not isinstance(choice, str):
        return choice
    if choice != "docker":
        raise ArgumentError(f"backend must be 'docker' or an object that makes machines, not {choice!r}")
    from gem_terminal.backends.docker.backend import DockerBackend

    key = tuple(sorted((build_args or {}).items()))
    with _lock:
        if key not in _made:
            backend = DockerBackend(build_args=build_args)
            _ = backend.engine.client  # it connects, or says what is missing
            _made[key] = backend
        return _made[key]


def _after_fork() -> None:
    # Connections and machines are the parent's.
    global _lock, _made
    _lock, _made = threading.Lock(), {}


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
