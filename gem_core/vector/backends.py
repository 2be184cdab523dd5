"""The backends: where the environments of a vector environment live.

Each takes a ``VectorSetup`` and, by keyword, its own options; plugins add more by the hook
``gem_register_vector_backends``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.types import Concurrency
from gem_core.vector.env import VectorEnv
from gem_core.vector.host import Host
from gem_core.vector.local import LocalHost, timeout_refused
from gem_core.vector.setup import VectorSetup


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
    return VectorEnv(setup, LocalHost(setup.factories(), concurrent=False))


def asynchronous(setup: VectorSetup) -> VectorEnv:
    """Step ``inline`` environments in place, ``async`` ones on the library's loop, and all others in threads.

    Raises:
        ArgumentError: There is a ``step_timeout``, and an environment runs in place, where nothing could keep it.
    """
    if setup.step_timeout is not None:
        for env_id in setup.all_ids:
            if setup.stack_kind(env_id) == "inline":
                raise timeout_refused(env_id)
    return VectorEnv(setup, _local(setup))


def processes(setup: VectorSetup, *, workers: int | None = None, worker_memory_bytes: int | None = None) -> VectorEnv:
    """Step environments in worker processes, many in each.

    Args:
        setup: See ``make_vec``.
        workers: Number of processes; by default one for each core, and no more than there are slots.
        worker_memory_bytes: Address space that a worker may use; beyond it, an environment meets a ``MemoryError``.
            None for as much as there is.
    """
    return VectorEnv(setup, _processes(setup, workers, worker_memory_bytes))


def auto(setup: VectorSetup, *, workers: int | None = None, worker_memory_bytes: int | None = None) -> VectorEnv:
    """Choose by what each environment says of itself.

    Those that compute for long, and with a ``step_timeout`` those that run in place, go to worker processes; all others
    stay here, as with ``async``.
    """
    kinds = {env_id: _kind(setup, env_id) for env_id in setup.all_ids}
    away = {env_id for env_id, kind in kinds.items() if _goes_away(setup, kind)}
    if not away:
        return VectorEnv(setup, _local(setup))
    remote: Host = _processes(setup, workers, worker_memory_bytes)
    if len(away) == len(kinds):
        return VectorEnv(setup, remote)
    local: Host = _local(setup)

    def host_of(env_id: str | None) -> int:
        if env_id not in kinds:
            # An id that only the plan names: by its class, without making one.
            return int(_goes_away(setup, setup.task_kind(env_id) or "thread"))
        return int(env_id in away)

    return VectorEnv(setup, local, remote, host_of=host_of)


def around(
    env: AnyEnv, *, seed: int | None = None, on_error: str = "truncate", keep_open: bool = False, plain: bool = True
) -> VectorEnv:
    """Return a vector environment of one slot around a given environment; see ``VectorEnv.around``.

    Args:
        env: What the slot begins with.
        seed: Seed of the run; None draws one.
        on_error: ``"truncate"`` or ``"raise"``.
        keep_open: Leave closing ``env`` to the caller.
        plain: Run it in the calling thread, whatever its ``concurrency``.
    """
    spares = [env]
    own_id = getattr(env.unwrapped, "env_id", None)

    def factory(env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
        if env_id is not None and env_id != own_id:
            raise ArgumentError(f"the plan asks for {env_id!r}, and the environment given is {env}")
        if spares and not overrides:
            return spares.pop()
        return cast("AnyEnv", env.get_wrapper_attr("spawn")(**overrides))

    setup = VectorSetup([own_id], [{}], [(own_id, {})], seed=seed, on_error=on_error)  # type: ignore[arg-type,list-item]  # checked there
    host = LocalHost([factory], concurrent=not plain)
    host.body(0).borrowed = env if keep_open else None
    return VectorEnv(setup, host)


def _kind(setup: VectorSetup, env_id: str) -> Concurrency:
    """Return what an environment needs, as far as it decides between here and workers, by its class if that will do."""
    by_class = setup.task_kind(env_id)
    if setup.wrappers_compute():
        return "process"
    if by_class is None or (by_class == "inline" and setup.step_timeout is not None):
        return setup.stack_kind(env_id)
    return by_class


def _goes_away(setup: VectorSetup, kind: Concurrency) -> bool:
    return kind == "process" or (kind == "inline" and setup.step_timeout is not None)


def _local(setup: VectorSetup) -> LocalHost:
    return LocalHost(setup.factories(), kinds=setup.task_kind, step_timeout=setup.step_timeout)


def _processes(setup: VectorSetup, workers: int | None, worker_memory_bytes: int | None) -> Host:
    from gem_core.vector.process import process_host

    return process_host(setup, workers=workers, worker_memory_bytes=worker_memory_bytes)
