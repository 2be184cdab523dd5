"""``EnvRunner``: makes, resets and steps one environment, and turns its exceptions into failures."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections.abc import Awaitable, Callable, Collection, Mapping
from functools import partial
from typing import Any, cast

from gem_core.closing import close_all
from gem_core.env.base import Env
from gem_core.env.checks import checked_reset, checked_result
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.seeding import checked_seed, stable_hash
from gem_core.env.wrapper import AnyEnv, concurrency_of, reset_async, step_async
from gem_core.errors import ArgumentError
from gem_core.failures import Failure, WorkerFailureError
from gem_core.making.environment import MadeSpec
from gem_core.records.episode import return_range_of
from gem_core.types import Action, Concurrency, ResetResult, StepResult
from gem_core.vector.joint import joint_reset, joint_step
from gem_core.vector.remote import RemoteEnv

logger = logging.getLogger("gem_core")

MakeEnv = Callable[[str | None, Mapping[str, Any]], AnyEnv]
"""Makes the environment for (id, keyword arguments)."""


class EnvRunner:
    """Runs one environment, in this process or in a worker.

    An exception becomes a ``Failure``, and the environment is then closed: the next reset makes a new one.

    Args:
        make: Makes the environment.
        borrowed: An environment that the caller owns and closes.
        in_place: Values of ``concurrency`` that run in the caller's thread.
    """

    def __init__(self, make: MakeEnv, borrowed: AnyEnv | None = None, in_place: Collection[str] = ()) -> None:
        self.env: AnyEnv | None = None
        self.concurrency: Concurrency | None = None
        """Concurrency of the environment with its wrappers; None while there is no environment."""
        self.in_place = False
        """Whether the environment runs in the caller's thread."""
        self._make, self._borrowed, self._in_place = make, borrowed, in_place
        self._made_for: tuple[str | None, Mapping[str, Any]] | None = None
        self._made_in = os.getpid()
        self._check_reset: Callable[[Any], ResetResult] | None = None
        self._check_step: Callable[[Any], StepResult] | None = None
        self._sampled = False
        self._draws: dict[str, int] = {}

    def has_env_for(self, env_id: str | None, kwargs: Mapping[str, Any]) -> bool:
        """Tell whether the present environment was made for an id and keyword arguments."""
        return self._made_for is not None and self._made_for[0] == env_id and _equal(self._made_for[1], kwargs)

    def make(self, env_id: str | None, kwargs: Mapping[str, Any]) -> Failure | None:
        """Make the environment for an id and keyword arguments unless it is present; return the failure, if any."""
        if self.env is not None:
            if self.has_env_for(env_id, kwargs):
                return None
            self.close()
        try:
            env = self._make(env_id, kwargs)
            self.concurrency = concurrency_of(env)
        except BaseException as error:  # noqa: BLE001 - see _failed
            return self._failed(error, "reset", making=True)
        self._check_reset, self._check_step = checked_reset, checked_result
        if isinstance(env, MultiAgentEnv):
            self._check_reset, self._check_step = partial(joint_reset, env), joint_step
        elif isinstance(env, RemoteEnv) or type(env) is Guard:  # its worker has checked the results, or the guard has
            self._check_reset = self._check_step = None
        self.in_place = self.concurrency in self._in_place and not isinstance(env, RemoteEnv)
        self.env, self._made_for, self._made_in = env, (env_id, kwargs), os.getpid()
        return None

    def reset(self, seed: int, options: Mapping[str, Any] | None) -> ResetResult | Failure:
        """Begin an episode."""
        self._sampled, self._draws = False, {}
        env: Any = self.env
        try:
            result = env.reset(seed=seed, options=options) if options else env.reset(seed=seed)
            return cast("ResetResult", result if self._check_reset is None else self._check_reset(result))
        except BaseException as error:  # noqa: BLE001 - see _failed
            return self._failed(error, "reset")

    def step(self, action: Action) -> StepResult | Failure:
        """Step the environment."""
        env: Any = self.env
        try:
            result = env.step(action)
            return cast("StepResult", result if self._check_step is None else self._check_step(result))
        except BaseException as error:  # noqa: BLE001 - see _failed
            return self._failed(error, "step")

    async def reset_async(self, seed: int, options: dict[str, Any] | None) -> ResetResult | Failure:
        """``reset`` by the environment's coroutine."""
        self._sampled, self._draws = False, {}
        work = reset_async(cast("AnyEnv", self.env), seed, options)
        return cast("ResetResult | Failure", await self._awaited(work, self._check_reset, "reset"))

    async def step_async(self, action: Action) -> StepResult | Failure:
        """``step`` by the environment's coroutine."""
        work = step_async(cast("AnyEnv", self.env), cast("str", action))
        return cast("StepResult | Failure", await self._awaited(work, self._check_step, "step"))

    async def _awaited(self, coroutine: Awaitable[Any], check: Callable[[Any], Any] | None, where: str) -> Any:
        try:
            result = await coroutine
            return result if check is None else check(result)
        except BaseException as error:
            if isinstance(error, GeneratorExit) and error.__traceback__ and error.__traceback__.tb_next is None:
                raise  # nothing inside raised it: this coroutine is closed from outside
            task = asyncio.current_task()
            if isinstance(error, asyncio.CancelledError) and task is not None and task.cancelling():
                raise  # by the engine, not by the environment
            return self._failed(error, where)

    def sample_random_action(self, seed: int | None, agent: str | None = None) -> str:
        """Return a valid action for the present state, from a generator seeded with ``seed`` in each episode.

        Of several agents, each has draws of its own, whatever the order in which they are asked.
        """
        env = self.env
        if env is None:
            return ""
        if isinstance(env, RemoteEnv):
            return env.draw_action(seed, agent)
        task: Any = env.unwrapped
        if seed is not None and agent is not None:
            self._draws[agent] = number = self._draws.get(agent, 0) + 1
            task.seed_actions(stable_hash(seed, agent, number))
        elif seed is not None and not self._sampled:
            if hasattr(task, "seed_actions"):
                task.seed_actions(checked_seed(seed))
            self._sampled = True
        return cast("str", env.get_wrapper_attr("sample_random_action")(*([] if agent is None else [agent])))

    def describe(self) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones), ``wrappers`` and, if it declares one, ``return_range``.

        The id is None if there is no environment.
        """
        env: Any = self.env
        if isinstance(env, RemoteEnv):
            return env.described or {"id": None, "kwargs": {}, "wrappers": []}
        spec = None if env is None else env.spec
        if spec is None:
            return {"id": None if env is None else type(env.unwrapped).__name__, "kwargs": {}, "wrappers": []}
        if not isinstance(spec, MadeSpec):
            raise ArgumentError(
                f"{spec.id} was made by gymnasium.make; a record needs what gem_core.make returns, or the id alone"
            )
        described = spec.recorded()
        declared = return_range_of(env.get_wrapper_attr("return_range") if isinstance(env.unwrapped, Env) else None)
        return described if declared is None else {**described, "return_range": declared}

    def apply(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return ``function(env, *args)``, called in the environment's process."""
        env = self.env
        return env.apply(function, *args) if isinstance(env, RemoteEnv) else function(env, *args)

    def _failed(self, error: BaseException, where: str, *, making: bool = False) -> Failure:
        """Close the environment after an exception; return the failure.

        Every exception ends only the episode, also a ``BaseException`` such as the panic of a library in Rust; only
        Ctrl-C is raised again. ``sys.exit`` in a child that the environment forked ends the child, which would
        otherwise go on with the program.
        """
        if isinstance(error, SystemExit) and os.getpid() != self._made_in:
            os._exit(error.code if isinstance(error.code, int) else error.code is not None)
        if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
            raise error
        logger.debug("gem: an environment failed in %s", where, exc_info=error)
        self.close()
        return error.failure if isinstance(error, WorkerFailureError) else Failure.of(error, where, making=making)

    def close(self) -> None:
        """Forget the environment, and close it unless the caller owns it."""
        if self.env is not None:
            close_all(self.forget())

    def forget(self) -> list[AnyEnv]:
        """Forget the environment; return it, unless there is none or the caller owns it."""
        env, self.env, self._made_for, self.concurrency, self.in_place = self.env, None, None, None, False
        return [] if env is None or env is self._borrowed else [env]


def _equal(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    try:
        return first is second or first == second
    except ValueError:  # the truth value of an array is ambiguous
        return False
