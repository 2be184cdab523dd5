"""Whether this machine can run terminal tasks, in words for ``gem doctor`` and ``make``."""

from __future__ import annotations

from collections.abc import Callable

from gem_core import RequirementStatus
from gem_core.docs import page_url
from gem_terminal.errors import EngineError


def docker(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether there is a container engine, Docker or Podman; looked at closely, whether it answers."""
    from gem_terminal.backends.docker.engine import Engine

    engine = Engine()
    if closely:
        return _status("the engine answers", "no engine answers", lambda: engine.client)
    return _status("there is an engine", "there is no engine", engine.places)


def bubblewrap(_: str, *, closely: bool = False) -> RequirementStatus:
    """Tell whether bubblewrap is installed; looked at closely, whether a sandbox starts."""
    from gem_terminal.backends.local import launch

    if closely:
        return _status("a sandbox starts", "no sandbox starts", launch.probe)
    return _status("is installed", "is not installed", launch.check)


def _status(met: str, unmet: str, check: Callable[[], object]) -> RequirementStatus:
    try:
        check()
    except EngineError as error:
        return RequirementStatus("unmet", unmet, f"{error}. See {page_url('terminal/#backends')}")
    return RequirementStatus("met", met)
