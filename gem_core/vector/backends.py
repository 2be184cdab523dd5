"""``make_vector``, and the built-in backends, which decide where environments run.

Each backend takes a ``VectorSetup`` and, by keyword, its own options; plugins add more by the hook
``gem_register_vector_backends``.
"""

from __future__ import annotations

import functools
from typing import Any

from gem_core.arguments import parse_choice
from gem_core.errors import ArgumentError
from gem_core.registry.choices import parsed_choices
from gem_core.registry.entry_points import construct
from gem_core.registry.lookup import registry
from gem_core.vector.process import process_pool
from gem_core.vector.setup import IdOrIds, VectorSetup
from gem_core.vector.slot import ALL_IN_PLACE
from gem_core.vector.vector_env import VectorEnv


def make_vector(ids: IdOrIds, num_envs: int | None, *, backend: object = "auto", **options: Any) -> VectorEnv:
    """Make several environments that are reset and stepped together; see ``make_vec`` for the arguments."""
    if isinstance(backend, str):
        name, backend_options = parsed_choices(backend, "backend")[0] if ":" in backend else (backend, {})
    else:
        rule = "a backend is a name, as 'process' or 'process:workers=2', or (name, {option: value})"
        name, backend_options = parse_choice(backend, rule, lambda one: isinstance(one, str))
    setup = VectorSetup.of(ids, num_envs, **options)
    vector: VectorEnv = construct(registry().backend(name), setup, **backend_options)
    return vector


def sync(setup: VectorSetup) -> VectorEnv:
    """Step one environment after another, in the calling thread.

    It contains the exceptions of an environment, but not a hang, which blocks the whole batch.

    Raises:
        ArgumentError: There is a ``step_timeout``, which this backend cannot enforce.
    """
    if setup.step_timeout is not None:
        raise ArgumentError(
            "step_timeout cannot be kept by backend='sync', where everything runs in the calling thread; "
            "use backend='auto' or 'process'"
        )
    return VectorEnv(setup, in_place=ALL_IN_PLACE)


def asynchronous(setup: VectorSetup) -> VectorEnv:
    """Step ``inline`` environments in place, ``async`` ones on the library's loop, and all others in threads.

    Raises:
        ArgumentError: ``step_timeout`` is given, and an environment runs in place, so that it cannot be enforced.
    """
    if setup.step_timeout is not None:
        for env_id in setup.records:
            if setup.concurrency(env_id) == "inline":
                raise ArgumentError(
                    f"step_timeout cannot be kept for {env_id!r}, which runs in place; use backend='auto' or "
                    "'process', whose workers can be killed"
                )
    return VectorEnv(setup, in_place=_in_place(setup))


def processes(setup: VectorSetup, *, workers: int | None = None) -> VectorEnv:
    """Step environments in worker processes, many in each.

    Args:
        setup: See ``make_vec``.
        workers: Number of processes; by default one for each core, and at most one for each slot.
    """
    return VectorEnv(setup, pool=process_pool(setup, workers=workers))


def auto(setup: VectorSetup, *, workers: int | None = None) -> VectorEnv:
    """Choose the place of each environment by its ``concurrency``.

    Environments with ``"process"``, and with a ``step_timeout`` those with ``"inline"``, go to worker processes; all
    others stay in this process, as with ``async``.
    """
    far = ("process",) if setup.step_timeout is None else ("process", "inline")
    in_pool = functools.cache(lambda env_id: setup.concurrency(env_id) in far)
    if not any(map(in_pool, setup.records)):
        return VectorEnv(setup, in_place=_in_place(setup))
    pool = process_pool(setup, workers=workers)
    return VectorEnv(setup, in_place=_in_place(setup), pool=pool, in_pool=in_pool)


def _in_place(setup: VectorSetup) -> tuple[str, ...]:
    # An environment that runs in place cannot be abandoned.
    return ("inline",) if setup.step_timeout is None else ()
