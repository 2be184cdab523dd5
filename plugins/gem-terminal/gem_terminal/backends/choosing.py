"""Which backend runs the tasks: by name, shared by all environments of a process."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gem_core.docs import page_url
from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend

NAMES = ("auto", "docker", "local")
VARIABLE = "GEM_TERMINAL_BACKEND"
"""Environment variable with the name that ``"auto"`` stands for; ``make_vec`` takes ``backend`` for itself."""

_lock = threading.Lock()
_made: dict[tuple[str, tuple[tuple[str, str], ...]], Backend] = {}


def shared_backend(choice: str | Backend, build_args: Mapping[str, str] | None = None) -> Backend:
    """Return a backend that can be used here.

    Args:
        choice: ``"docker"``, ``"local"``, ``"auto"`` (what the environment variable GEM_TERMINAL_BACKEND names,
            else Docker where an engine answers, else local), or an object, which is returned as it is.
        build_args: Arguments for the build of images.

    Raises:
        ArgumentError: There is no backend of that name.
        EngineError: It is not there; with ``"auto"``, neither is.
    """
    if not isinstance(choice, str):
        return choice
    what = "backend"
    if choice == "auto" and (named := os.environ.get(VARIABLE)):
        choice, what = named, VARIABLE
    if choice not in NAMES:
        hint = did_you_mean(choice, NAMES)
        raise ArgumentError(f"{what} must be one of {', '.join(map(repr, NAMES))}, not {choice!r}.{hint}")
    arguments = tuple(sorted((build_args or {}).items()))
    with _lock:
        key = (choice, arguments)
        if key not in _made:
            # Under its own name as well, so that "auto" and "docker" are one backend with one pool.
            backend = _chosen(choice, dict(arguments))
            _made[key] = _made.setdefault((backend.name, arguments), backend)
        return _made[key]


def _chosen(choice: str, build_args: dict[str, str]) -> Backend:
    if choice != "auto":
        return _docker(build_args) if choice == "docker" else _local()
    try:
        return _docker(build_args)
    except EngineError as no_docker:
        try:
            return _local()
        except EngineError as no_local:
            raise EngineError(
                f"no terminal task can run here. Docker: {no_docker}. Local: {no_local}. "
                f"See {page_url('terminal/#backends')}"
            ) from no_local


def _docker(build_args: dict[str, str]) -> Backend:
    from gem_terminal.backends.docker.backend import DockerBackend

    backend = DockerBackend(build_args=build_args)
    _ = backend.engine.client  # it connects, or says what is missing
    return backend


def _local() -> Backend:
    from gem_terminal.backends.local import launch
    from gem_terminal.backends.local.backend import LocalBackend

    launch.probe()
    return LocalBackend()


def _after_fork() -> None:
    # Connections and machines are the parent's.
    global _lock, _made
    _lock, _made = threading.Lock(), {}


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
