"""What must be there before an environment can run, and how to get it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import shutil
from collections.abc import Iterable

from gem_core.errors import MissingRequirementError
from gem_core.specs import EnvSpec


def unmet(requirements: Iterable[str]) -> dict[str, str]:
    """Return the requirements that are not met, each with what to do about it.

    ``"network"`` and ``"hub"`` are not tried here: whether they answer is known only when they are used. Words that
    are not known here are taken as met.
    """
    advice = {requirement: _advice(requirement) for requirement in requirements}
    return {requirement: text for requirement, text in advice.items() if text}


def check_requirements(record: EnvSpec) -> None:
    """Raise when a record needs what is not there.

    Raises:
        MissingRequirementError: Names each requirement and what to install, start or set.
    """
    missing = unmet(record.requires) if record.requires else {}
    if missing:
        raise MissingRequirementError(f"{record.id} cannot run here: {'; '.join(missing.values())}")


def _advice(requirement: str) -> str:
    kind, _, name = requirement.partition(":")
    if kind == "key" and not os.environ.get(name):
        return f"it needs a key: set the environment variable {name}"
    if kind == "package" and not _is_installed(name):
        return f"it needs the package {name}: 'pip install {name}'"
    if kind == "command" and shutil.which(name) is None:
        return f"it needs the command {name!r} on the PATH: install it"
    if kind == "docker" and not (os.environ.get("DOCKER_HOST") or os.path.exists("/var/run/docker.sock")):
        return "it needs a container engine: install and start Docker, or set DOCKER_HOST"
    if kind == "never":
        return name
    return ""


def _is_installed(name: str) -> bool:
    """Tell whether a distribution, or a module, of this name is there."""
    try:
        importlib.metadata.distribution(name)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        pass
    else:
        return True
    try:
        return importlib.util.find_spec(name.replace("-", "_")) is not None
    except (ImportError, ValueError):  # no parent package, an empty name, or a module without a specification
        return False
