"""Vector environments, which run many environments at once, and the classes to build a backend from.

A backend is a function of a ``VectorSetup`` that returns a ``VectorEnv``. Where environments live in workers that can
be killed, it gives the vector environment a ``WorkerPool``, whose ``start`` returns a ``Worker``: something that passes
a request to a ``WorkerLoop`` in another process, and returns the reply. The plugin gem-ray is an example.
"""

from gem_core.failures import Failure
from gem_core.vector.remote import NoRoomError, RemoteEnv, Worker, WorkerDiedError, WorkerPool
from gem_core.vector.setup import VectorSetup
from gem_core.vector.vector_env import VectorEnv
from gem_core.vector.worker import WorkerLoop

__all__ = [
    "Failure",
    "NoRoomError",
    "RemoteEnv",
    "VectorEnv",
    "VectorSetup",
    "Worker",
    "WorkerDiedError",
    "WorkerLoop",
    "WorkerPool",
]
