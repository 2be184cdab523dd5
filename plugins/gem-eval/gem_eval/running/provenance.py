"""Where a run comes from: versions, host, and the code of environments and agents."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial
from importlib import metadata
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

from gem_core import AgentSpec
from gem_core.making import wrapper_targets
from gem_core.registry import registry

Code = dict[str, str]
"""Digest of the source by the name of the package, or of the module that is in none."""


def versions() -> dict[str, str]:
    """Return the version of Python and of every installed distribution."""
    found = {each.name: each.version for each in reversed(list(metadata.distributions()))}  # the first on the path wins
    return {"python": platform.python_version(), **dict(sorted(found.items(), key=lambda each: each[0].lower()))}


def host() -> dict[str, Any]:
    """Return what kind of machine this is."""
    return {"name": platform.node(), "platform": platform.platform(), "processors": os.cpu_count()}


def code_of_env(env_id: str, kwargs: Mapping[str, Any]) -> Code | None:
    """Return the code of an environment: of its class, its wrappers and tools, and of functions among its arguments."""
    record = registry().env(env_id)
    given = {**record.kwargs, **kwargs}
    targets = [
        registry().wrapper(target).entry_point if isinstance(target, str) and ":" not in target else target
        for target in wrapper_targets(given.pop("wrappers", ()))
    ]
    return code_of([record.entry_point, *targets, *filter(callable, given.values())])


def code_of_agent(agent: Any) -> Code | None:
    """Return the code of an agent, given as an object or by name."""
    if isinstance(agent, str):
        name = agent.partition(":")[0]
        if any(record.name == name for record in registry().specs(AgentSpec)):
            agent = registry().agent(name).entry_point
    return code_of([agent])


def code_of(things: Iterable[Any]) -> Code | None:
    """Return the digests of the packages and modules of some things.

    Args:
        things: Classes, functions, other objects, or names as ``"package.module:Name"``.

    Returns:
        By package, that of all its files; by module in no package, that of its file and of those that it imports from
        its folder; of what a notebook or a script defines, that of the definition. None where a source is missing.
    """
    found: Code = {}
    for thing in things:
        while isinstance(thing, partial):
            thing = thing.func
        if not isinstance(thing, str) and not hasattr(thing, "__qualname__"):
            thing = type(thing)
        module = thing.partition(":")[0] if isinstance(thing, str) else thing.__module__
        name = module.partition(".")[0]
        if name in sys.stdlib_module_names or name in found:
            continue
        try:
            if name == "__main__":
                found[thing.__qualname__] = _digest([inspect.getsource(thing).encode()])
            else:
                found[name] = _digest(path.read_bytes() for path in _sources(importlib.import_module(name)))
        except (ImportError, OSError, TypeError):
            return None
    return found


def _sources(module: Any) -> list[Path]:
    """Return the files of a package, or of a module with those that it imports from its folder."""
    if hasattr(module, "__path__"):
        return sorted(path for folder in module.__path__ for path in Path(folder).rglob("*.py"))
    file = Path(module.__file__)
    if "site-packages" in file.parts:
        return [file]
    finder = ModuleFinder([str(file.parent)])
    with suppress(SyntaxError):
        finder.run_script(str(file))
    return sorted(
        {file, *(Path(name) for each in finder.modules.values() if (name := getattr(each, "__file__", None)))}
    )


def _digest(parts: Iterable[bytes]) -> str:
    content = hashlib.sha256()
    for part in parts:
        content.update(hashlib.sha256(part).digest())
    return content.hexdigest()[:16]
