"""What dead processes have left on an engine, found by its labels and removed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.images import REPOSITORY, lock_alone
from gem_terminal.backends.docker.labels import LABEL, OWNER, RUN, is_dead
from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client, Engine

_KINDS = ("container", "image", "volume", "network")


def reap(engine: Engine, *, images: bool = False, run: str = "") -> list[str]:
    """Remove what belongs to processes that are dead; what belongs to others is left alone.

    Args:
        engine: The engine.
        images: Also every image that was ever built, but those that a container still uses.
        run: Only what has this value of the label :data:`RUN`; empty for all.

    Returns:
        What was removed, a line each.

    Raises:
        EngineError: The engine does not answer.
    """
    removed: list[str] = []
    with engine.asking("look for what was left behind") as client:
        found = [(kind, *row) for kind in _KINDS for row in _left(client, kind, run)]
    for kind, name, about in found:
        if _remove(engine, kind, name):
            removed.append(f"{kind} {about}")
    removed += _layers(engine)
    if images:
        removed += _images(engine)
    return removed


class Reaping:
    """One :func:`reap` in a thread of its own: a thing that the engine does not get removed holds up nobody for long.

    Args:
        engine: The engine.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._error: EngineError | None = None
        self._thread = threading.Thread(target=self._run, name="gem-terminal-reaper", daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float) -> None:
        """Wait until all is removed, or for so long; what is left then is still worked on.

        Raises:
            EngineError: The engine does not answer.
        """
        self._thread.join(timeout_s)
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            reap(self._engine)
        except EngineError as error:
            self._error = error


def _left(client: Client, kind: str, run: str) -> list[tuple[str, str]]:
    """Return the things of one kind whose owner is dead: what to call them, and what they are."""
    wanted = {"label": [f"{OWNER}"] + ([f"{RUN}={run}"] if run else [])}
    rows: list[dict[str, Any]]
    if kind == "container":
        rows = client.containers(all=True, filters=wanted)
    elif kind == "image":
        rows = client.images(all=True, filters=wanted)
    elif kind == "volume":
        rows = client.volumes(filters=wanted).get("Volumes") or []
    else:
        rows = client.networks(filters=wanted)
    left = []
    for row in rows:
        marks = row.get("Labels") or {}
        if is_dead(marks.get(OWNER, "")):
            names = row.get("Names") or row.get("RepoTags") or [row.get("Name") or row.get("Id")]
            left.append((str(row.get("Id") or row.get("Name")), f"{marks.get(LABEL, '')} {str(names[0]).lstrip('/')}"))
    return left


def _remove(engine: Engine, kind: str, name: str) -> bool:
    """Remove one thing; False when it is gone already, or cannot be removed now."""
    try:
        with engine.asking("remove what was left behind") as client:
            if kind == "container":
                client.remove_container(name, v=True, force=True)
            elif kind == "image":
                client.remove_image(name, force=True)
            elif kind == "volume":
                client.remove_volume(name, force=True)
            else:
                client.remove_network(name)
    except (EngineError, docker.errors.NotFound):
        return False
    return True


def _layers(engine: Engine) -> list[str]:
    """Remove the layers of builds that were broken off; those that an image is made of are no such layers."""
    with engine.asking("look for layers") as client:
        rows = client.images(filters={"label": [f"{LABEL}"], "dangling": True})
    found = [str(row["Id"]) for row in rows if (row.get("Labels") or {}).get(LABEL) in ("layer", "image")]
    # And what each was made of, as far as nothing else is.
    return [f"layer {name}" for name in unused(engine, found, lambda image: not image.get("RepoTags"))]


def _images(engine: Engine) -> list[str]:
    with engine.asking("look for images") as client:
        rows = client.images(name=REPOSITORY, filters={"label": [f"{LABEL}=image"]})
    found = [str(tag) for row in rows for tag in row.get("RepoTags") or []]
    return [f"image {name}" for name in unused(engine, found, lambda _: True)]


def unused(engine: Engine, names: Sequence[str], is_meant: Callable[[dict[str, Any]], bool]) -> list[str]:
    """Remove images while nobody builds, and return which were; without force, so that one that is used stays.

    Who wants to build waits for one removal at most, and an engine that hangs is not asked again.
    """
    removed = []
    for name in names:
        with lock_alone("building") as nobody_builds:
            if not nobody_builds:
                break
            try:
                with engine.asking("remove an image") as client:
                    if is_meant(client.image(name)):  # since it was looked for, a build may have made something of it
                        client.discard_image(name)
                        removed.append(name)
            except docker.errors.NotFound:
                continue
            except EngineError as error:
                if isinstance(error.__cause__, docker.errors.APIError):
                    continue  # it is used
                break
    return removed
