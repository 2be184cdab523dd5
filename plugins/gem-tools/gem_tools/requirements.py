"""Whether this machine has a container engine and bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess

from gem_core import RequirementStatus

_DOCKER_SOCKET = "/var/run/docker.sock"
_PROBE_S = 2.0


def docker(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether there is a container engine; looked at closely, whether it answers."""
    host = os.environ.get("DOCKER_HOST")
    if not host and not os.path.exists(_DOCKER_SOCKET):
        advice = "it needs a container engine: install and start Docker, or set DOCKER_HOST"
        return RequirementStatus("unmet", "there is no engine", advice)
    if not closely:
        return RequirementStatus("met", "DOCKER_HOST names an engine" if host else "there is a socket")
    try:
        connection = _connected(host or f"unix://{_DOCKER_SOCKET}")
        if connection is None:
            return RequirementStatus("untried", "DOCKER_HOST names an engine in a way that is not tried here")
        with connection:
            connection.sendall(b"GET /_ping HTTP/1.0\r\nHost: docker\r\n\r\n")
            answers = connection.recv(64).startswith(b"HTTP/")
    except PermissionError:
        advice = "let your user use the engine: join the group 'docker', or run a rootless engine"
        return RequirementStatus("unmet", "the engine's socket may not be opened", advice)
    except (OSError, ValueError) as error:
        return RequirementStatus(
            "unmet", f"the engine cannot be reached ({type(error).__name__})", "start the container engine"
        )
    if not answers:
        return RequirementStatus(
            "unmet", "what listens there is no container engine", "correct DOCKER_HOST, or unset it"
        )
    return RequirementStatus("met", "the engine answers")


def _connected(host: str) -> socket.socket | None:
    """Return a connection to an engine, or None where it takes more than a socket, as by ssh or TLS."""
    scheme, _, rest = host.partition("://")
    if scheme == "unix":
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(_PROBE_S)
        try:
            connection.connect(rest)
        except OSError:
            connection.close()
            raise
        return connection
    if scheme in ("tcp", "http") and os.environ.get("DOCKER_TLS_VERIFY", "") in ("", "0"):
        name, _, port = rest.rstrip("/").rpartition(":")
        return socket.create_connection((name.strip("[]") or rest, int(port or 2375)), _PROBE_S)
    return None


def bubblewrap(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether bubblewrap is installed; looked at closely, whether a sandbox starts."""
    if shutil.which("bwrap") is None:
        advice = "it needs bubblewrap: install the package 'bubblewrap' of your system"
        return RequirementStatus("unmet", "the command 'bwrap' is not on the PATH", advice)
    if not closely:
        return RequirementStatus("met", "is on the PATH")
    command = ["bwrap", "--unshare-all", "--ro-bind", "/", "/", "true"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_PROBE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return RequirementStatus("unmet", f"it does not start ({type(error).__name__})", "reinstall bubblewrap")
    if done.returncode:
        reason = " ".join(done.stderr.decode(errors="replace").split())[:120]
        return RequirementStatus("unmet", f"it fails: {reason}", "allow unprivileged user namespaces on this system")
    return RequirementStatus("met", "a sandbox starts")
