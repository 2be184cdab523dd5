"""What dead processes have left on an engine, found by its labels and removed."""

from __future__ import annotations

import contextlib
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
    with lock_alone("building") as nobody_builds:
        if nobody_builds:
            removed += _layers(engine)
            if images:
                removed += _images(engine)
    return removed


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
    removed: list[str] = []
    with engine.asking("look for layers") as client:
        rows = client.images(filters={"label": [f"{LABEL}"], "dangling": True})
    for row in rows:
        with contextlib.suppress(EngineError, docker.errors.NotFound), engine.asking("remove a layer") as client:
            if (row.get("Labels") or {}).get(LABEL) in ("layer", "image"):
                client.remove_image(row["Id"])  # and what it was made of, as far as nothing else is
                removed.append(f"layer {row['Id']}")
    return removed


def _images(engine: Engine) -> list[str]:
    removed: list[str] = []
    with engine.asking("look for images") as client:
        rows = client.images(name=REPOSITORY, filters={"label": [f"{LABEL}=image"]})
    for row in rows:
        for tag in row.get("RepoTags") or []:
            # Without force: one that a container uses stays, and is named by nobody as removed.
            with contextlib.suppress(EngineError, docker.errors.NotFound), engine.asking("remove an image") as client:
                client.remove_image(tag)
                removed.append(f"image {tag}")
    return removed
