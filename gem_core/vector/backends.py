"""The backends: where the environments of a vector environment live.

Each takes a ``VectorSetup`` and, by keyword, its own options; plugins add more by the hook
``gem_register_vector_backends``.
"""

from __future__ import annotations

from gem_core.errors import ArgumentError
from gem_core.types import Concurrency
from gem_core.vector.local import LocalExecutor, SyncExecutor
from gem_core.vector.setup import VectorSetup
from gem_core.vector.vector_env import VectorEnv
from gem_core.vector.workers.process import ProcessExecutor


def sync(setup: VectorSetup) -> VectorEnv:
    """Step one environment after another, in the calling thread.

    It contains exceptions of an environment, and nothing worse: a hang holds up the batch.

    Raises:
        ArgumentError: There is a ``step_timeout``, which nothing could keep.
    """
    if setup.step_timeout is not None:
        raise ArgumentError(
            "step_timeout cannot be kept by backend='sync', where everything runs in the calling thread; "
            "use backend='auto' or 'process'"
        )
    return VectorEnv(setup, SyncExecutor(setup))


def asynchronous(setup: VectorSetup) -> VectorEnv:
    """Step ``inline`` environments in place, ``async`` ones on the library's loop, and all others in threads.

    Raises:
        ArgumentError: There is a ``step_timeout``, and an environment runs in place, where nothing could keep it.
    """
    if setup.step_timeout is not None:
        for env_id in setup.all_ids:
            if setup.concurrency(env_id) == "inline":
                raise ArgumentError(
                    f"step_timeout cannot be kept for {env_id!r}, which runs in place; use backend='auto' or "
                    "'process', whose workers can be killed"
                )
    return VectorEnv(setup, _local(setup))


def processes(setup: VectorSetup, *, workers: int | None = None, worker_memory_bytes: int | None = None) -> VectorEnv:
    """Step environments in worker processes, many in each.

    Args:
        setup: See ``make_vec``.
        workers: Number of processes; by default one for each core, and no more than there are slots.
        worker_memory_bytes: Address space that a worker may use; beyond it, an environment meets a ``MemoryError``.
            None for as much as there is.
    """
    return VectorEnv(setup, ProcessExecutor(setup, workers=workers, worker_memory_bytes=worker_memory_bytes))


def auto(setup: VectorSetup, *, workers: int | None = None, worker_memory_bytes: int | None = None) -> VectorEnv:
    """Choose by what each environment says of itself.

    Those that compute for long, and with a ``step_timeout`` those that run in place, go to worker processes; all others
    stay here, as with ``async``.
    """
    in_workers = {env_id: _needs_worker(setup, setup.concurrency(env_id)) for env_id in setup.all_ids}
    if not any(in_workers.values()):
        return VectorEnv(setup, _local(setup))
    remote = ProcessExecutor(setup, workers=workers, worker_memory_bytes=worker_memory_bytes)
    if all(in_workers.values()):
        return VectorEnv(setup, remote)

    def executor_of(env_id: str | None) -> int:
        if env_id not in in_workers:
            # An id that only the plan names: by its class, without making one.
            return int(_needs_worker(setup, setup.task_concurrency(env_id)))
        return int(in_workers[env_id])

    return VectorEnv(setup, _local(setup), remote, executor_of=executor_of)


def _needs_worker(setup: VectorSetup, concurrency: Concurrency | None) -> bool:
    return concurrency == "process" or (concurrency == "inline" and setup.step_timeout is not None)


def _local(setup: VectorSetup) -> LocalExecutor:
    # What runs in place cannot be abandoned.
    return LocalExecutor(setup, in_place=["inline"] if setup.step_timeout is None else [])
