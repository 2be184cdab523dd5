"""``EnvRunner``: makes, resets and steps the environment of one slot, and turns its exceptions into failures."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

from gem_core.background import in_thread
from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.results import checked_reset, checked_result
from gem_core.env.seeding import checked_seed, stable_hash
from gem_core.env.spec import EnvRecipe
from gem_core.env.wrapper import AnyEnv, concurrency_of, reset_async, step_async
from gem_core.errors import ArgumentError
from gem_core.records.episode import return_range_of
from gem_core.types import Action, Concurrency, ResetResult, StepResult
from gem_core.vector.commands import Command, Failure, Outcome, Rebuild, Reset
from gem_core.vector.joint import joint_reset, joint_step

logger = logging.getLogger("gem_core")

EnvFactory = Callable[[str | None, Mapping[str, Any]], AnyEnv]
"""Makes the environment for (id, keyword arguments)."""


class EnvRunner:
    """Runs the environment of a slot, in this process or in a worker.

    An exception becomes a ``Failure``, and the environment is then closed: the next reset makes a new one.

    Args:
        slot: Number of the slot.
        factory: Makes the environment.
    """

    __slots__ = (
        "_draws",
        "_factory",
        "_made_for",
        "_reset_result",
        "_sampled",
        "_step_result",
        "borrowed",
        "concurrency",
        "env",
        "env_step",
        "slot",
    )

    def __init__(self, slot: int, factory: EnvFactory) -> None:
        self.slot = slot
        self.env: AnyEnv | None = None
        self.concurrency: Concurrency | None = None
        """Concurrency of the environment with its wrappers; None while there is no environment."""
        self.borrowed: AnyEnv | None = None
        """An environment that the caller owns and closes."""
        self.env_step: Callable[[Any], Any] = _nothing_to_step
        """Steps the environment and checks the result; may raise anything."""
        self._reset_result: Callable[[Any], ResetResult] = checked_reset
        self._step_result: Callable[[Any], StepResult] = checked_result
        self._factory = factory
        self._made_for: tuple[str | None, Mapping[str, Any]] | None = None
        self._sampled = False
        self._draws: dict[str, int] = {}

    def perform(self, command: Command) -> Outcome:
        """Run a command."""
        if isinstance(command, Reset):
            return self.reset(command)
        return self.rebuild(command) if isinstance(command, Rebuild) else self.step(command)

    async def perform_async(self, command: Command) -> Outcome:
        """Run a command without blocking the event loop."""
        try:
            if isinstance(command, Reset):
                if failure := self.prepare(command.env_id, command.kwargs):
                    return failure
                self._sampled, self._draws = False, {}
                return self._reset_result(await reset_async(cast("AnyEnv", self.env), command.seed, command.options))
            if not isinstance(command, Rebuild):
                action: Any = command
                return self._step_result(await step_async(self.env, action) if self.env else _nothing_to_step(action))
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "reset" if isinstance(command, Reset) else "step")
        return await in_thread(self.rebuild, command)

    def has_env_for(self, env_id: str | None) -> bool:
        """Tell whether the present environment has an id, with any keyword arguments."""
        return self._made_for is not None and self._made_for[0] == env_id

    def fits(self, command: Command) -> bool:
        """Tell whether a command is for the present environment."""
        if type(command) is not Reset:
            return True
        made_for = self._made_for
        if made_for is None or made_for[0] != command[0]:
            return False
        return made_for[1] is command[1] or _equal(made_for[1], command[1])

    def prepare(self, env_id: str | None, kwargs: Mapping[str, Any]) -> Failure | None:
        """Make the environment for an id and keyword arguments unless it is present; return the failure, if any."""
        made_for = self._made_for
        if made_for is not None and made_for[0] == env_id and (made_for[1] is kwargs or _equal(made_for[1], kwargs)):
            return None
        self.discard()
        try:
            env = self._factory(env_id, kwargs)
            self.concurrency = concurrency_of(env)
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            _check_contained(error)
            return Failure.of(error, "reset", making=True)
        if isinstance(env, MultiAgentEnv):
            self._reset_result, self._step_result = partial(joint_reset, env), joint_step
        else:
            self._reset_result, self._step_result = checked_reset, checked_result
        # A guard without wrappers around it has checked the result already.
        self.env_step = env.step if type(env) is Guard else partial(_checked_step, env, self._step_result)
        self.env, self._made_for = env, (env_id, kwargs)
        return None

    def reset(self, command: Reset) -> ResetResult | Failure:
        """Begin an episode."""
        env_id, kwargs, seed, options = command
        if failure := self.prepare(env_id, kwargs):
            return failure
        self._sampled, self._draws = False, {}
        env: Any = self.env
        try:
            return self._reset_result(env.reset(seed=seed, options=options) if options else env.reset(seed=seed))
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "reset")

    def step(self, action: Action) -> StepResult | Failure:
        """Step the environment."""
        try:
            return cast("StepResult", self.env_step(action))
        except BaseException as error:  # noqa: BLE001 - see _check_contained
            return self.failed(error, "step")

    def rebuild(self, command: Rebuild) -> StepResult | Failure:
        """Replay an episode and step it; a replay that differs from the first time is a failure."""
        failure = self.restore(command)
        return self.step(command.action) if failure is None else failure

    def restore(self, command: Rebuild) -> Failure | None:
        """Replay an episode without the next step; return the failure, if any."""
        outcome: Outcome = self.reset(command.reset)
        for action in command.actions:
            if isinstance(outcome, Failure) or _is_over(outcome):
                break
            outcome = self.step(action)
        if isinstance(outcome, Failure):
            why = f"the episode could not be replayed: {outcome.message}"
        elif _is_over(outcome):
            why = "the episode could not be replayed: its replay ended early"
        elif outcome[0] != command.observation:
            why = "a replay of the episode went another way: it is not deterministic"
        else:
            return None
        self.discard()
        return Failure("collateral", f"its worker was lost, and {why}")

    def sample_random_action(self, seed: int | None, agent: str | None = None) -> str:
        """Return a valid action for the present state, from a generator seeded with ``seed`` in each episode.

        Of several agents, each has draws of its own, whatever the order in which they are asked.
        """
        env = self.env
        if env is None:
            return ""
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
        spec = None if env is None else env.spec
        if spec is None:
            return {"id": None if env is None else type(env.unwrapped).__name__, "kwargs": {}, "wrappers": []}
        if not isinstance(spec, EnvRecipe):
            raise ArgumentError(
                f"{spec.id} was made by gymnasium.make; a record needs what gem_core.make returns, or the id alone"
            )
        described = {"id": spec.id, "kwargs": spec.overrides(), "wrappers": spec.listed_wrappers()}
        declared = return_range_of(env.get_wrapper_attr("return_range") if isinstance(env.unwrapped, Env) else None)
        return described if declared is None else {**described, "return_range": declared}

    def tasks(self, env_id: str | None, kwargs: Mapping[str, Any]) -> tuple[int | None, bool]:
        """Return ``num_tasks`` and ``endless_tasks`` of an environment; make it unless it is present."""
        failure = self.prepare(env_id, kwargs)
        if failure is not None:
            raise cast("BaseException", failure.error)
        task = cast("Any", self.env).unwrapped
        return task.num_tasks, task.endless_tasks

    def apply(self, env_id: str | None, kwargs: Mapping[str, Any], function: Callable[..., Any], *args: Any) -> Any:
        """Return ``function(env, slot, *args)``; make the environment of the id if there is none."""
        failure = self.prepare(env_id, kwargs) if self.env is None else None
        if failure is not None:
            raise cast("BaseException", failure.error)
        return function(self.env, self.slot, *args)

    def failed(self, error: BaseException, where: str) -> Failure:
        """Close the environment after an exception; return the failure."""
        _check_contained(error)
        logger.debug("gem: slot %d failed in %s", self.slot, where, exc_info=error)
        self.discard()
        return Failure.of(error, where)

    def release(self) -> None:
        """Close an environment that is not needed any more; the caller's stays here for the next run."""
        if self.env is not self.borrowed:
            self.discard()

    def discard(self) -> None:
        """Forget the environment, and close it unless the caller owns it."""
        env, self.env, self.env_step, self._made_for, self.concurrency = self.env, None, _nothing_to_step, None, None
        if env is None or env is self.borrowed:
            return
        try:
            env.close()
        except BaseException as error:
            _check_contained(error)
            logger.warning("gem: closing the environment of slot %d failed", self.slot, exc_info=True)


def _is_over(outcome: ResetResult | StepResult) -> bool:
    return len(outcome) == 5 and (outcome[2] or outcome[3])


def _equal(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    try:
        return first == second
    except ValueError:  # the truth value of an array is ambiguous
        return False


def _checked_step(env: AnyEnv, check: Callable[[Any], StepResult], action: Any) -> StepResult:
    return check(env.step(action))


def _nothing_to_step(action: Action) -> Any:
    raise RuntimeError("there is no environment to step")


def _check_contained(error: BaseException) -> None:
    """Raise again what does not come from the environment: Ctrl-C, and the end of a coroutine that is collected.

    Everything else ends only the episode, including a ``BaseException`` such as the panic of a library in Rust: in a
    thread or a task it would be lost, and its slot would be waited for without end.
    """
    if isinstance(error, GeneratorExit):
        raise error
    if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
        raise error
