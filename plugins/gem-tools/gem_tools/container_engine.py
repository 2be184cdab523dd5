"""Find a container engine: Docker, or Podman by its socket of the same kind. Every plugin that needs one asks here."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from gem_core import RequirementStatus
from gem_core.errors import MissingRequirementError

_ANSWER_S = 5.0
_START = (
    "install and start Docker ('systemctl start docker', or Docker Desktop) or Podman "
    "('systemctl --user start podman.socket'), or set DOCKER_HOST to an engine's address"
)


class EnginePlace(NamedTuple):
    """An address where an engine may be.

    Args:
        url: As ``unix:///var/run/docker.sock``.
        source: What names it: ``"DOCKER_HOST"``, ``"context 'NAME'"``, ``"usual place"``.
        context: The context of Docker's client that names it; empty if none does.
    """

    url: str
    source: str
    context: str = ""


def engine_places() -> list[EnginePlace]:
    """Return where to look for an engine, in order; what the user names is the only place.

    These are DOCKER_HOST, the context of Docker's client, Docker's usual socket, and Podman's.
    """
    if host := os.environ.get("DOCKER_HOST"):
        return [EnginePlace(host, "DOCKER_HOST")]
    if (context := _context()) is not None:
        return [context]
    own = os.path.join(os.environ.get("XDG_RUNTIME_DIR", "/run"), "podman/podman.sock")
    sockets = dict.fromkeys(["/var/run/docker.sock", own, "/run/podman/podman.sock"])
    return [EnginePlace(f"unix://{path}", "usual place") for path in sockets]


def find_engine(url: str = "") -> EnginePlace:
    """Return the first place where a server listens. One that is reached by ssh or TLS is not tried.

    Args:
        url: The only place to look at; empty for those of ``engine_places``.

    Raises:
        MissingRequirementError: There is none; says where it was looked for, and how to start one.
    """
    refusals = []
    for place in [EnginePlace(url, "named")] if url else engine_places():
        try:
            _connect(place.url)
            return place
        except (OSError, ValueError) as error:
            refusals.append(f"{place.url} ({place.source}): {why_silent(error)}")
    raise MissingRequirementError(f"no container engine answers at {'; '.join(refusals)}; {_START}")


def probe(_: str = "", *, closely: bool = False) -> RequirementStatus:
    """Tell whether there is an engine, as ``requires=("docker",)`` asks."""
    try:
        place = find_engine()
    except MissingRequirementError as error:
        return RequirementStatus("unmet", "no engine answers", str(error))
    if not _is_tried(place.url):
        return RequirementStatus("untried", f"{place.source} names an engine in a way that is not tried here")
    return RequirementStatus("met", f"the engine at {place.url} answers")


def why_silent(error: BaseException) -> str:
    """Return what an error of a connection says, and what to do about a refusal by the system."""
    words = " ".join(str(error).split())[:300] or type(error).__name__
    denied = "permission denied" in words.lower()
    return f"{words}: join the group 'docker', or run Podman as this user" if denied else words


def _context() -> EnginePlace | None:
    """Return the place in the chosen context of Docker's client; None for its default.

    Source: https://docs.docker.com/engine/manage-resources/contexts/.
    """
    folder = Path(os.environ.get("DOCKER_CONFIG") or os.path.expanduser("~/.docker"))
    name = os.environ.get("DOCKER_CONTEXT")
    with contextlib.suppress(OSError, ValueError, AttributeError):
        name = name or json.loads((folder / "config.json").read_text("utf-8")).get("currentContext")
    if not name or name == "default":
        return None
    about = folder / "contexts" / "meta" / hashlib.sha256(name.encode()).hexdigest() / "meta.json"
    try:
        url = str(json.loads(about.read_text("utf-8"))["Endpoints"]["docker"]["Host"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MissingRequirementError(
            f"the context {name!r} of Docker's client cannot be read ({error}): see 'docker context ls'"
        ) from error
    return EnginePlace(url, f"context {name!r}", name)


def _is_tried(url: str) -> bool:
    plain = os.environ.get("DOCKER_TLS_VERIFY", "") in ("", "0")
    return url.startswith("unix://") or (url.startswith(("tcp://", "http://")) and plain)


def _connect(url: str) -> None:
    """Raise OSError or ValueError unless a server listens; an address that needs more than a socket passes."""
    if not _is_tried(url):
        return
    place = urlsplit(url)
    if place.scheme != "unix":
        socket.create_connection((place.hostname or "localhost", place.port or 2375), _ANSWER_S).close()
        return
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(_ANSWER_S)
        connection.connect(place.path)
