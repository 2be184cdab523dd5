"""The errors of terminal tasks, below those of the core.

::

    GemError
    ├── UsageError
    │   └── TaskError          a task folder that cannot be read, or asks for what a backend does not have
    └── MachineError           a machine or its engine failed, whatever the agent did: never a reward of 0
        ├── EngineError        the container engine is missing, unreachable, or refuses; says what to do
        ├── BuildError         an image could not be built; has the end of the log
        └── MachineLostError   the machine of an episode is gone, or its terminal is
"""

from __future__ import annotations

from gem_core.errors import GemError, UsageError


class TaskError(UsageError):
    """A task folder cannot be read, or asks for what the backend does not have; the message names file and field."""


class MachineError(GemError):
    """A machine or its engine failed, whatever the agent did."""


class EngineError(MachineError):
    """The container engine is missing, unreachable or refuses; the message says what to do."""


class BuildError(MachineError):
    """An image could not be built.

    Args:
        message: What failed and what to do, with the end of the log.
        log: The end of the build log.
    """

    def __init__(self, message: str, log: str = "") -> None:
        super().__init__(message)
        self.log = log


class MachineLostError(MachineError):
    """The machine of an episode is gone, or its terminal is.

    Args:
        message: What happened.
        by_agent: Whether the agent's own processes are the cause, as with a killed terminal or a full memory; None
            where that is unknown.
    """

    def __init__(self, message: str, *, by_agent: bool | None = None) -> None:
        super().__init__(message)
        self.by_agent = by_agent
