"""Vector environments, which run many environments at once, and the classes to build a backend from.

A backend is a function of a ``VectorSetup`` that returns ``VectorEnv(setup, executor)``. An ``Executor`` is where
environments live; it has an ``EnvRunner`` for each slot, which makes, resets and steps the environment::

    class MyExecutor(Executor):
        def __init__(self, setup):
            self.runners = [EnvRunner(slot, factory) for slot, factory in enumerate(setup.factories())]

        def start(self, batch):  # start commands; report the outcome of each, from any thread
            for slot, ticket, command in batch:
                self.scheduler.advance(slot, ticket, self.runners[slot].perform(command))

If environments live in workers that can be killed, derive from ``RemoteExecutor`` and ``WorkerLink`` instead, and run a
``Worker`` in each worker; the plugin gem-ray is an example.
"""

from gem_core.vector.commands import Command, Failure, Outcome, Reset
from gem_core.vector.executor import CommandTimes, Executor, Launch
from gem_core.vector.runner import EnvRunner
from gem_core.vector.setup import VectorSetup
from gem_core.vector.vector_env import VectorEnv
from gem_core.vector.workers.remote import RemoteExecutor, Running, WorkerLink
from gem_core.vector.workers.worker import Worker

__all__ = [
    "Command",
    "CommandTimes",
    "EnvRunner",
    "Executor",
    "Failure",
    "Launch",
    "Outcome",
    "RemoteExecutor",
    "Reset",
    "Running",
    "VectorEnv",
    "VectorSetup",
    "Worker",
    "WorkerLink",
]
