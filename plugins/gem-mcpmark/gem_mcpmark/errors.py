"""The errors of PostgreSQL tasks, below those of the core.

::

    GemError
    ├── UsageError
    │   └── TaskError       a folder of tasks that cannot be read, or data that is missing; says what to provide
    └── PostgresError       a server, a dump or a script failed, whatever the agent did: never a reward of 0
"""

from __future__ import annotations

from gem_core.errors import GemError, UsageError


class TaskError(UsageError):
    """A folder of tasks cannot be read, or a task's data is missing; the message says what to provide."""


class PostgresError(GemError):
    """A server, a dump or a script of a task failed, whatever the agent did."""
