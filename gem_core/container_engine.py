"""Find a container engine: Docker, or Podman by its socket of the same kind. All who need one ask here."""

from __future__ import annotations

import hashlib
import json
import os
import socket
from pathlib import Path
from typing import NamedTuple

from gem_core.errors import MissingRequirementError
from gem_core.registry.requirements import RequirementStatus

_ANSWER_S = 5.0
_MOST_BYTES = 65_536
_START = (
    "Install and start Docker ('systemctl start docker', or Docker Desktop) or Podman "
    "('systemctl --user start podman.socket'), or set DOCKER_HOST to an engine's address"
)
_ADVICE = (
    (
        ("permission denied", "errno 13"),
        "this user may not use it: join the group 'docker', or run Podman as this user",
    ),
    (
        ("no such file", "errno 2]", "connection refused", "errno 111"),
        "it is not running there: start it, as with 'systemctl start docker'",
    ),
    (("timed out", "timeout"), "it did not answer in time: look at its load and its log"),
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
    sockets = ["/var/run/docker.sock", "/run/podman/podman.sock"]
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        sockets.insert(1, os.path.join(runtime, "podman/podman.sock"))
    return [EnginePlace(f"unix://{path}", "usual place") for path in sockets]


def find_engine(url: str = "") -> EnginePlace:
    """Return the first place where an engine answers. One that is reached by ssh or TLS is not asked.

    Args:
        url: The only place to look at; empty for those of ``engine_places``.

    Raises:
        MissingRequirementError: There is none; says where it was looked for, and how to start one.
    """
    refusals = []
    for place in [EnginePlace(url, "named")] if url else _there():
        try:
            _ask(place.url)
            return place
        except (OSError, ValueError) as error:
            refusals.append(f"{place.url} ({place.source}): {why_silent(error)}")
    raise MissingRequirementError(f"no container engine answers at {'; '.join(refusals)}")


def probe(_: str = "", *, closely: bool = False) -> RequirementStatus:
    """Tell whether there is an engine, as ``requires=("docker",)`` asks; looked at closely, whether it answers."""
    try:
        place = find_engine() if closely else _there()[0]
    except MissingRequirementError as error:
        return RequirementStatus("unmet", "no engine answers" if closely else "there is no engine", str(error))
    if not closely:
        return RequirementStatus("met", f"there is one at {place.url} ({place.source})")
    if _is_asked(place.url):
        return RequirementStatus("met", f"the engine at {place.url} answers")
    return RequirementStatus("untried", f"{place.source} names an engine in a way that is not tried here")


def why_silent(error: BaseException) -> str:
    """Return what an error of a connection says, and what to do."""
    words = " ".join(str(error).split())
    for parts, advice in _ADVICE:
        if any(part in words.lower() for part in parts):
            return f"{advice} ({words[:200]})"
    return words[:300] or type(error).__name__


def _there() -> list[EnginePlace]:
    """Return the places that a user names, or whose socket is there."""
    known = engine_places()
    found = [p for p in known if p.source != "usual place" or os.path.lexists(p.url.removeprefix("unix://"))]
    if not found:
        looked = ", ".join(place.url for place in known)
        raise MissingRequirementError(f"no container engine: nothing at {looked}. {_START}")
    return found


def _context() -> EnginePlace | None:
    """Return the place in the chosen context of Docker's client; None for its default.

    Source: https://docs.docker.com/engine/manage-resources/contexts/.
    """
    folder = Path(os.environ.get("DOCKER_CONFIG") or os.path.expanduser("~/.docker"))
    try:
        name = os.environ.get("DOCKER_CONTEXT")
        if not name:
            name = json.loads((folder / "config.json").read_text("utf-8")).get("currentContext")
    except (OSError, ValueError, AttributeError):
        return None
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


def _is_asked(url: str) -> bool:
    plain = os.environ.get("DOCKER_TLS_VERIFY", "") in ("", "0")
    return url.startswith("unix://") or (url.startswith(("tcp://", "http://")) and plain)


def _ask(url: str) -> None:
    """Raise OSError or ValueError unless an engine answers; where more than a socket is needed, do nothing."""
    if not _is_asked(url):
        return
    scheme, _, rest = url.partition("://")
    if scheme == "unix":
        connection = socket.socket(socket.AF_UNIX)
    else:
        name, _, port = rest.rstrip("/").rpartition(":")
        connection = socket.create_connection((name.strip("[]") or rest, int(port or 2375)), _ANSWER_S)
    with connection:
        connection.settimeout(_ANSWER_S)
        if scheme == "unix":
            connection.connect(rest)
        connection.sendall(b"GET /version HTTP/1.0\r\nHost: docker\r\n\r\n")
        answer = b""
        while len(answer) < _MOST_BYTES and (data := connection.recv(_MOST_BYTES)):
            answer += data
    if b'"ApiVersion"' not in answer:
        raise ValueError("what answers there is no container engine: correct or unset DOCKER_HOST")
