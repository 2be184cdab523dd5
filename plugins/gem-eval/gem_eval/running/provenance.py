"""Where a run comes from: versions, host, and the code of agents that are modules of the user's."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core import AgentSpec
from gem_core.registry import registry

if TYPE_CHECKING:
    from gem_eval.suites import Model


def versions() -> dict[str, str]:
    """Return the version of Python and of every installed distribution."""
    # By the names of folders: importlib.metadata reads every file, which takes 0.1 s for 200 distributions.
    folders = [path.stem for folder in sys.path for path in Path(folder).glob("*.dist-info")]
    found = [stem.partition("-") for stem in folders]
    named = {name.replace("_", "-"): version for name, _, version in reversed(found)}
    return {"python": platform.python_version(), **dict(sorted(named.items(), key=lambda each: each[0].lower()))}


def host() -> dict[str, Any]:
    """Return what kind of machine this is."""
    return {"name": platform.node(), "platform": platform.platform(), "processors": os.cpu_count()}


def code_hash(model: Model) -> str | None:
    """Return the SHA-256 of the file of an agent that is given as ``MODULE:CALLABLE``; None for another."""
    name = model.agent.partition(":")[0]
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None or any(record.name == name for record in registry().named(AgentSpec)):
        return None
    try:
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except OSError:
        return None
