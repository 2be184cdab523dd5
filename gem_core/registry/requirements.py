"""What must be there before an environment can run, and how to get it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from gem_core.errors import MissingRequirementError
from gem_core.registry.specs import EnvSpec

_DOCKER_SOCKET = "/var/run/docker.sock"
_PROBE_S = 2.0
_ON = {"1", "ON", "YES", "TRUE"}
# A line of a distribution's metadata that belongs to an extra: the package and the extra.
_OF_EXTRA = re.compile(r"""([\w.-]+).*;.*\bextra\s*==\s*["']([\w.-]+)["']""")


@dataclass(frozen=True)
class Finding:
    """What is known of one requirement.

    Args:
        status: ``"met"``, ``"unmet"``, ``"untried"`` (known only in use), or ``"unknown"`` (a word of somebody else's).
        detail: What was seen, in a few words; never the value of a key.
        advice: What to do about it; empty where nothing need be done.
    """

    status: str
    detail: str
    advice: str = ""


@dataclass(frozen=True)
class Kind:
    """A kind of requirement: the word before the colon, and how to tell whether it is met.

    Args:
        check: Called with what stands after the colon before each ``make``: cheap, and without a connection.
        probe: A closer look for ``gem doctor``, which may take up to two seconds; by default the same.
    """

    check: Callable[[str], Finding]
    probe: Callable[[str], Finding] | None = None


def find(requirement: str, *, closely: bool = False) -> Finding:
    """Return what is known of a requirement.

    Args:
        requirement: A word such as ``"docker"``, or a kind and a name such as ``"key:NAME"``.
        closely: Whether to try what takes a moment, as asking the container engine whether it answers.
    """
    word, _, name = requirement.partition(":")
    kind = KINDS.get(word)
    if kind is None:
        return Finding("unknown", "not a word that GEM knows")
    return (kind.probe or kind.check)(name) if closely else kind.check(name)


def unmet(requirements: Iterable[str]) -> dict[str, str]:
    """Return the requirements that are not met, each with what to do about it.

    ``"network"`` and ``"hub"`` are not tried here: whether they answer is known only when they are used. Words that
    are not known here are taken as met.
    """
    found = {requirement: find(requirement) for requirement in requirements}
    return {requirement: finding.advice for requirement, finding in found.items() if finding.status == "unmet"}


def check_requirements(record: EnvSpec, given: Iterable[str] = ()) -> None:
    """Raise when a record needs what is not there.

    Args:
        record: What is made.
        given: The arguments that it is made with.

    Raises:
        MissingRequirementError: Names each requirement and what to install, start or set.
    """
    met = {f"argument:{name}" for name in given}
    missing = unmet(word for word in record.requires if word not in met) if record.requires else {}
    if missing:
        raise MissingRequirementError(f"{record.id} cannot run here: {'; '.join(missing.values())}")


def installed_version(name: str) -> str | None:
    """Return the version of a distribution, or None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None


def _key(name: str) -> Finding:
    if os.environ.get(name):
        return Finding("met", "is set")
    return Finding("unmet", "is not set", f"it needs a key: set the environment variable {name}")


def _package(name: str) -> Finding:
    distribution, _, extra = name.removesuffix("]").partition("[")
    if extra:
        return _extra(distribution, extra)
    version = installed_version(name)
    if version is not None:
        return Finding("met", f"version {version}")
    try:
        importable = importlib.util.find_spec(name.replace("-", "_")) is not None
    except (ImportError, ValueError):  # no parent package, an empty name, or a module without a specification
        importable = False
    if importable:
        return Finding("met", "can be imported")
    return Finding("unmet", "is not installed", f"it needs the package {name}: 'pip install {name}'")


def _extra(distribution: str, extra: str) -> Finding:
    """Tell whether the packages are installed that an extra adds, as in ``gem-games[textarena]``."""
    try:
        lines = importlib.metadata.requires(distribution) or []
    except (importlib.metadata.PackageNotFoundError, ValueError):
        lines = []
    added = [match[1] for line in lines if (match := _OF_EXTRA.match(line)) and match[2] == extra]
    missing = [name for name in added if installed_version(name) is None]
    if added and not missing:
        return Finding("met", f"has {', '.join(added)}")
    advice = f"it needs an extra of {distribution}: 'pip install \"{distribution}[{extra}]\"'"
    return Finding("unmet", f"lacks {', '.join(missing)}" if missing else "is not installed", advice)


def _command(name: str) -> Finding:
    if shutil.which(name) is not None:
        return Finding("met", "is on the PATH")
    return Finding("unmet", "is not on the PATH", f"it needs the command {name!r} on the PATH: install it")


def _docker(_: str) -> Finding:
    host = os.environ.get("DOCKER_HOST")
    if host:
        return Finding("met", "DOCKER_HOST names an engine")
    if os.path.exists(_DOCKER_SOCKET):
        return Finding("met", "there is a socket")
    advice = "it needs a container engine: install and start Docker, or set DOCKER_HOST"
    return Finding("unmet", "there is no engine", advice)


def _docker_answers(_: str) -> Finding:
    cheap = _docker(_)
    if cheap.status != "met":
        return cheap
    host = os.environ.get("DOCKER_HOST") or f"unix://{_DOCKER_SOCKET}"
    try:
        connection = _connected(host)
        if connection is None:
            return Finding("untried", "DOCKER_HOST names an engine in a way that is not tried here")
        with connection:
            connection.sendall(b"GET /_ping HTTP/1.0\r\nHost: docker\r\n\r\n")
            answers = connection.recv(64).startswith(b"HTTP/")
    except PermissionError:
        advice = "let your user use the engine: join the group 'docker', or run a rootless engine"
        return Finding("unmet", "the engine's socket may not be opened", advice)
    except (OSError, ValueError) as error:
        return Finding("unmet", f"the engine cannot be reached ({type(error).__name__})", "start the container engine")
    if not answers:
        return Finding("unmet", "what listens there is no container engine", "correct DOCKER_HOST, or unset it")
    return Finding("met", "the engine answers")


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


def _bubblewrap(_: str) -> Finding:
    if shutil.which("bwrap") is None:
        advice = "it needs bubblewrap: install the package 'bubblewrap' of your system"
        return Finding("unmet", "the command 'bwrap' is not on the PATH", advice)
    return Finding("met", "is on the PATH")


def _bubblewrap_works(_: str) -> Finding:
    cheap = _bubblewrap(_)
    if cheap.status != "met":
        return cheap
    command = ["bwrap", "--unshare-all", "--ro-bind", "/", "/", "true"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_PROBE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Finding("unmet", f"it does not start ({type(error).__name__})", "reinstall bubblewrap")
    if done.returncode:
        reason = " ".join(done.stderr.decode(errors="replace").split())[:120]
        return Finding("unmet", f"it fails: {reason}", "allow unprivileged user namespaces on this system")
    return Finding("met", "a sandbox starts")


def _hub(_: str) -> Finding:
    for name in ("HF_HUB_OFFLINE", "HF_DATASETS_OFFLINE", "TRANSFORMERS_OFFLINE"):
        if os.environ.get(name, "").upper() in _ON:
            return Finding("untried", f"offline by {name}: only what is in the cache", f"unset {name} to download")
    return Finding("untried", "online, and not tried here")


def _network(_: str) -> Finding:
    return Finding("untried", "known only when it is used")


def _never(reason: str) -> Finding:
    return Finding("unmet", "cannot run anywhere", reason) if reason else Finding("met", "")


def _argument(name: str) -> Finding:
    return Finding("unmet", "is given to make", f"it needs an argument: make(…, {name}=…)")


KINDS: dict[str, Kind] = {
    "docker": Kind(_docker, _docker_answers),
    "bubblewrap": Kind(_bubblewrap, _bubblewrap_works),
    "hub": Kind(_hub),
    "network": Kind(_network),
    "key": Kind(_key),
    "package": Kind(_package),
    "command": Kind(_command),
    "never": Kind(_never),
    "argument": Kind(_argument),
}
"""Every kind of requirement that the core knows; a plugin may use words of its own, which are taken as met."""

SERVICES = ("docker", "bubblewrap", "hub", "network")
"""Those that say something about the machine, whatever is installed."""


def which_gem() -> Finding:
    """Tell whether the command ``gem`` of this PATH is ours; RubyGems has one of that name."""
    path = shutil.which("gem")
    if path is None:
        return Finding("unmet", "no 'gem' is on the PATH", "activate its environment, or use 'python -m gem_core'")
    if Path(path).resolve().parent == Path(sys.executable).parent.resolve():
        return Finding("met", path)
    try:
        with open(path, "rb") as script:
            ours = b"gem_core" in script.read(4096)
    except OSError:
        ours = False
    if ours:
        return Finding("met", f"{path}, of another installation of GEM")
    return Finding("unmet", f"{path} is another program called 'gem'", "use 'gem-core', or 'python -m gem_core'")
