"""Check the requirements of an environment, and say how to meet them."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

from gem_core.errors import MissingRequirementError
from gem_core.registry.distributions import extras_of, installed_version
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EnvSpec, RequirementSpec

_ON = {"1", "ON", "YES", "TRUE"}


@dataclass(frozen=True)
class RequirementStatus:
    """The status of one requirement.

    Args:
        status: ``"met"``, ``"unmet"``, ``"untried"`` (known only in use), or ``"unknown"`` (no probe for this word).
        detail: The finding in a few words; never the value of a key.
        advice: The next step; empty if there is none.
    """

    status: str
    detail: str
    advice: str = ""


def find(requirement: str, *, closely: bool = False) -> RequirementStatus:
    """Return the status of a requirement.

    Args:
        requirement: A word such as ``"network"``, or a word and an argument such as ``"key:NAME"``.
        closely: Whether to run slow checks too, such as asking a container engine whether it answers.
    """
    word, _, argument = requirement.partition(":")
    match word:
        case "key":
            advice = f"it needs a key: set the environment variable {argument}"
            return _status(bool(os.environ.get(argument)), "is set", "is not set", advice)
        case "package":
            return _package(argument)
        case "command":
            advice = f"it needs the command {argument!r} on the PATH: install it"
            return _status(shutil.which(argument) is not None, "is on the PATH", "is not on the PATH", advice)
        case "argument":
            advice = f"it needs an argument: make(…, {argument}=…), or --set {argument}=… of gem run"
            return RequirementStatus("unmet", "is given to make", advice)
        case "never":
            return RequirementStatus("unmet", "cannot run anywhere", argument)
        case "hub" if os.environ.get("HF_HUB_OFFLINE", "").upper() in _ON:
            detail = "offline by HF_HUB_OFFLINE: only what is in the cache"
            return RequirementStatus("untried", detail, "unset HF_HUB_OFFLINE to download")
        case "network" | "hub":
            return RequirementStatus("untried", "online, and not tried here")
    # A word of a plugin. For those above, a worker process need not load the installed plugins.
    record = next((each for each in registry().specs(RequirementSpec) if each.name == word), None)
    if record is None:
        return RequirementStatus("unknown", "not a word that GEM knows")
    probe = load_entry_point(record.entry_point, f"requirement {word!r}")
    return cast("RequirementStatus", probe(argument, closely=closely))


def unmet(requirements: Iterable[str]) -> dict[str, str]:
    """Return the requirements that are not met, each with the next step.

    ``"network"`` and ``"hub"`` are not tried here: whether they answer is known only when they are used. Words that
    no plugin offers a probe for are taken as met.
    """
    found = {requirement: find(requirement) for requirement in requirements}
    return {requirement: seen.advice for requirement, seen in found.items() if seen.status == "unmet"}


def check_requirements(record: EnvSpec, given: Iterable[str] = ()) -> None:
    """Raise when a record needs what is not there.

    Args:
        record: What is made.
        given: The arguments that it is made with.

    Raises:
        MissingRequirementError: Names each requirement and what to install, start or set.
    """
    if not record.requires:
        return
    met = {f"argument:{name}" for name in given}
    missing = unmet(word for word in record.requires if word not in met)
    if missing:
        raise MissingRequirementError(f"{record.id} cannot run here: {'; '.join(missing.values())}")


def _package(name: str) -> RequirementStatus:
    """Tell whether a package is installed, or the packages of an extra, as in ``gem-games[textarena]``."""
    distribution, _, extra = name.removesuffix("]").partition("[")
    wanted = extras_of(distribution).get(extra, []) if extra else [name]
    missing = [each for each in wanted if not _is_installed(each)]
    found = f"has {', '.join(f'{each} {installed_version(each)}' for each in wanted)}"
    what = f"an extra of {distribution}" if extra else f"the package {name}"
    command = f'pip install "{name}"' if extra else f"pip install {name}"
    lacking = f"lacks {', '.join(missing) or name}"
    return _status(bool(wanted) and not missing, found, lacking, f"it needs {what}: '{command}'")


def _status(is_met: bool, found: str, lacking: str, advice: str) -> RequirementStatus:
    return RequirementStatus("met", found) if is_met else RequirementStatus("unmet", lacking, advice)


def _is_installed(name: str) -> bool:
    try:
        return installed_version(name) is not None or importlib.util.find_spec(name.replace("-", "_")) is not None
    except (ImportError, ValueError):  # no parent package, an empty name, or a module without a specification
        return False
