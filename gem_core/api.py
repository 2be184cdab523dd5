"""The main functions: ``make``, ``make_vec``, ``register``, ``spec`` and ``list_envs``."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from gem_core.registry.lookup import registry
from gem_core.registry.specs import EntryPoint, EnvSpec

if TYPE_CHECKING:
    from gem_core.env.wrapper import AnyEnv
    from gem_core.making.environment import MadeSpec
    from gem_core.making.layers import Wrappers
    from gem_core.records.plans import PlanItem
    from gem_core.vector.setup import Autoreset, Backend, IdOrIds, OnError
    from gem_core.vector.vector_env import VectorEnv

_SPEC_KEYWORDS = ("summary", "tags", "max_turns", "requires", "deterministic", "seats")


def register(id: str, entry_point: EntryPoint, **kwargs: Any) -> None:
    """Register an environment under an id.

    Args:
        id: ``namespace:Name[-vN][-variant]``.
        entry_point: ``"package.module:Class"``, or a callable that returns an environment.
        **kwargs: ``summary``, ``tags``, ``max_turns``, ``requires``, ``deterministic`` and ``seats`` describe it (see
            ``EnvSpec``); every other keyword goes to the environment when it is made. ``max_turns`` is what
            Gymnasium calls ``max_episode_steps``.

    Raises:
        RegistrationError: The id is malformed or taken.
    """
    described = {name: kwargs.pop(name) for name in _SPEC_KEYWORDS if name in kwargs}
    registry().add(EnvSpec(id=id, entry_point=entry_point, kwargs=kwargs, **described))


def make(id: str | EnvSpec | MadeSpec, *, wrappers: Wrappers = (), **kwargs: Any) -> AnyEnv:
    """Make an environment by id.

    Args:
        id: Id of a registered environment, or its record, or the ``spec`` of one that was made.
        wrappers: Names of wrappers and tools, innermost first, with options behind a colon as on the command line:
            ``"python,concat:max_turns=4"``; or a list: ``["python", ("concat", {"max_turns": 4})]``. They go around
            the wrappers that a ``spec`` has already. If several agents act, they go around every seat; or around some,
            as in ``{"white": "python,concat"}``.
        **kwargs: Keyword arguments over the registered ones; ``render_mode`` works for every environment.

    Raises:
        UnknownEnvError: No such id; the message names the nearest, or the plugin to install.
        UnknownWrapperError: No such wrapper or tool.
        ArgumentError: A keyword argument that the environment does not have; the message names those it has.
        MissingRequirementError: Something has to be installed, started or set first.
        EntryPointError: The environment's module cannot be imported.
    """
    from gem_core.making.environment import MadeSpec, make_from

    if isinstance(id, MadeSpec):
        return id.make(wrappers=wrappers, **kwargs)
    record = id if isinstance(id, EnvSpec) else registry().env(id)
    return make_from(record, kwargs, wrappers)


def make_vec(
    ids: IdOrIds,
    num_envs: int | None = None,
    *,
    backend: Backend = "auto",
    autoreset: Autoreset = "same_step",
    wrappers: Wrappers = (),
    seed: int | None = None,
    plan: Iterable[PlanItem] | None = None,
    step_timeout: float | None = None,
    on_error: OnError = "truncate",
    max_faults: int | None = None,
    **kwargs: Any,
) -> VectorEnv:
    """Make several environments that are reset and stepped together.

    Args:
        ids: One id, or several for a mixed batch; the slots take them in turn. Each may come with keyword arguments of
            its own, as in ``("game:Sudoku-v0-easy", {"max_turns": 9})``, and with ``wrappers`` of its own among them,
            which are put around those for all. Where there are fewer slots than ids, a plan reaches them all, as that
            of ``rollout`` does.
        num_envs: Number of slots; by default one for each id.
        backend: Place that environments run in: ``"sync"``, ``"async"``, ``"process"``, one that a plugin brings, or
            ``"auto"``, which chooses by each environment's ``concurrency``. Its options go along as in
            ``"process:workers=4"`` or ``("process", {"workers": 4})``.
        autoreset: When the next episode begins. ``"same_step"``: in the step that ended the last one, whose end is in
            ``info["final_obs"]`` and ``info["final_info"]``. ``"next_step"``: in the next step, whose action is
            ignored. ``"disabled"``: when ``reset(options={"reset_mask": …})`` says so.
        wrappers: Put around each environment; see ``make``.
        seed: Seed of the run, from which every episode's own is made; None draws one, found as ``vec.seed``.
        plan: Items that episodes start from, drawn by all slots; see ``gem_core.records.plans``.
        step_timeout: Seconds that a step, or a reset with the making of its environment, may take; None for no
            limit. What takes longer is given up as a fault of its slot: its thread is abandoned, or its worker
            killed. What runs in place cannot be given up: it goes to worker processes under ``"auto"``, and is refused
            by ``"sync"`` and ``"async"``.
        on_error: ``"truncate"`` ends the episode of an environment that fails and replaces it; ``"raise"`` raises.
        max_faults: Faults in a row, with no finished episode between them, that do not stop the run yet; by default 16,
            or twice the number of slots if that is more.
        **kwargs: Keyword arguments for every environment.

    Raises:
        UnknownEnvError: No such id.
        UnknownBackendError: No such backend.
        ArgumentError: A value that is not accepted.
    """
    from gem_core.vector.backends import make_vector

    return make_vector(
        ids,
        num_envs,
        backend=backend,
        wrappers=wrappers,
        kwargs=kwargs,
        seed=seed,
        plan=plan,
        autoreset=autoreset,
        step_timeout=step_timeout,
        on_error=on_error,
        max_faults=max_faults,
    )


def spec(id: str) -> EnvSpec:
    """Return the record of an environment.

    Raises:
        UnknownEnvError: No such id; the message names the nearest.
    """
    return registry().env(id)


def list_envs(namespace: str | None = None) -> list[str]:
    """Return the ids of all environments in order, or of one namespace (or a glob such as ``game:*-easy``)."""
    return [record.id for record in registry().envs(namespace)]


def print_envs(namespace: str | None = None) -> None:
    """Write the ids of all environments to standard output, each with its summary."""
    records = registry().envs(namespace)
    width = max((len(record.id) for record in records), default=0)
    for record in records:
        sys.stdout.write(f"{record.id:<{width}}  {record.summary}".rstrip() + "\n")
