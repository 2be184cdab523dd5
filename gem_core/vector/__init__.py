"""Vector environments: what runs many environments at once, and what a backend of your own is made from.

A backend is a function of a ``VectorSetup`` that returns ``VectorEnv(setup, host)``. A ``Host`` is where environments
live; it keeps a ``Body`` for each slot, which makes, resets and steps the environment, and does what is asked of it::

    class MyHost(Host):
        def __init__(self, setup):
            self.bodies = [Body(slot, factory) for slot, factory in enumerate(setup.factories())]

        def start(self, batch):  # begin to do commands; tell the engine what came of each, from any thread
            for slot, ticket, command in batch:
                self.engine.advance(self, slot, ticket, self.bodies[slot].perform(command))

``advance`` returns what to do next for the same slot, or None: see ``docs/writing-a-plugin.md`` for the whole.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_core.vector.body import Body
    from gem_core.vector.commands import Command, Failure, Outcome, Reset
    from gem_core.vector.env import VectorEnv
    from gem_core.vector.host import Host, Launch
    from gem_core.vector.local import answer
    from gem_core.vector.setup import VectorSetup

_MODULE_OF = {
    "Body": "body",
    "Command": "commands",
    "Failure": "commands",
    "Host": "host",
    "Launch": "host",
    "Outcome": "commands",
    "Reset": "commands",
    "VectorEnv": "env",
    "VectorSetup": "setup",
    "answer": "local",
}

__all__ = [
    "Body",
    "Command",
    "Failure",
    "Host",
    "Launch",
    "Outcome",
    "Reset",
    "VectorEnv",
    "VectorSetup",
    "answer",
]


def __getattr__(name: str) -> Any:
    # Lazy, since the modules in here import each other by this package.
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'gem_core.vector' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"gem_core.vector.{module}"), name)
    globals()[name] = value
    return value
