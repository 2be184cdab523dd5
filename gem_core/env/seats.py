"""Seats of an environment of several agents: each as an environment of its own, and wrappers around them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar, cast

from gem_core.background import in_thread, run_without_loop, side_by_side
from gem_core.env.base import Env
from gem_core.env.checks import check_actions, check_seats, reset_needed
from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv, result_of
from gem_core.env.wrapper import AnyEnv, Wrapper, concurrency_of, most_demanding, reset_async, step_async
from gem_core.errors import ArgumentError
from gem_core.types import Concurrency, ResetResult, StepResult

if TYPE_CHECKING:
    from gymnasium import spaces

C = TypeVar("C", bound=type[Any])


def reads_from_env(*names: str) -> Callable[[C], C]:
    """Return a decorator of a class whose attributes of these names are those of the environment inside, ``env``."""

    def decorate(cls: C) -> C:
        for name in names:
            setattr(cls, name, property(attrgetter(f"env.{name}")))
        return cls

    return decorate


@reads_from_env("answer_fences", "answer_tags", "metadata", "render", "render_mode")
class SeatEnv(Env):
    """One seat of an environment of several agents, as an environment for one.

    Args:
        env: The environment.
        seat: Name of the agent.

    Raises:
        ArgumentError: There is no such seat.
    """

    def __init__(self, env: MultiAgentEnv, seat: str) -> None:
        super().__init__()
        check_seats([seat], env.possible_agents)
        self.env, self.seat = env, seat
        self.observation_space = env.observation_space(seat)
        self.action_space = env.action_space(seat)

    def sample_random_action(self) -> str:
        """Return a valid response of this seat."""
        return self.env.sample_random_action(self.seat)

    def gold_action(self) -> str | None:
        """Return a response by which the task of this seat is solved."""
        return self.env.gold_action(self.seat)


PutAround = Callable[[SeatEnv], AnyEnv]
"""Puts wrappers around the environment as one seat sees it."""


@reads_from_env("env_id", "np_random", "np_random_seed")
class WrappedSeat(SeatEnv):
    """A seat with its wrappers, and its channel to the task that all seats share.

    A step is in two halves, since the others act between them: ``hand_in`` passes a response through the wrappers from
    the outside in, and ``hear`` passes the result from the inside out. What is between them is kept as plain data, so
    that the environment can be forked there.

    Args:
        env: The environment.
        seat: Name of the agent.
        around: Puts the wrappers around it.

    Raises:
        ArgumentError: A wrapper is not made from hooks alone.
    """

    def __init__(self, env: MultiAgentEnv, seat: str, around: PutAround = lambda seat: seat) -> None:
        super().__init__(env, seat)
        self.outermost = around(self)
        self.held: str | None = None
        """The response that waits for those of others."""
        self.added = 0.0
        """What the wrappers added to the rewards of this episode."""
        self._layers = _layers(self.outermost)
        self._given: list[str] | None = None
        """The response that awaits its result, as each wrapper was given it, outermost first; None if there is none."""

    @property
    def spec(self) -> Any:  # type: ignore[override]  # read from the environment
        """What the environment was made from, with the wrappers that this seat has inside it."""
        spec = self.env.spec
        return None if spec is None else dataclasses.replace(spec, wrappers=spec.wrappers_of(self.seat))

    async def prepare(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Prepare the wrappers for an episode."""
        self.held, self.added, self._given = None, 0.0, None
        for layer in self._layers:
            await layer.run_hook("before_reset", seed, options)

    async def begin(self, result: ResetResult) -> ResetResult:
        """Return the seat's first observation and info, as the wrappers pass them on."""
        for layer in reversed(self._layers):
            result = await layer.run_hook("after_reset", result)
        return result

    async def hand_in(self, action: str) -> StepResult | None:
        """Hold a response for the task; return the result of a wrapper that answers it itself, as a tool does."""
        given: list[str] = []
        for layer in self._layers:
            outcome = await layer.run_hook("before_step", action)
            if isinstance(outcome, tuple):
                return await self._pass_on(given, outcome, 0.0)
            given.append(action)
            action = outcome
        self.held, self._given = action, given
        return None

    async def hear(self, result: StepResult) -> StepResult:
        """Return the result of a step of the task, as the wrappers pass it on.

        If the seat has ended before it ever acted, that is the result unchanged.
        """
        observation, reward, terminated, truncated, info = result
        if self._given is not None:
            given, self._given = self._given, None
            return await self._pass_on(given, result, reward)
        if terminated or truncated:
            return result
        observation, info = await self.begin((observation, info))
        return observation, reward, False, False, info

    async def _pass_on(self, given: list[str], result: StepResult, paid: float) -> StepResult:
        for layer, action in reversed(list(zip(self._layers, given, strict=False))):
            result = await layer.run_hook("after_step", action, result)
        self.added += result[1] - paid
        return result


_METHODS = ("reset", "step", "reset_async", "step_async")


def _layers(env: AnyEnv) -> list[Wrapper]:
    """Return the wrappers of a seat, outermost first.

    Raises:
        ArgumentError: One is not made from hooks alone.
    """
    layers = []
    while not isinstance(env, WrappedSeat):
        if not isinstance(env, Wrapper) or any(
            getattr(type(env), name) is not getattr(Wrapper, name) for name in _METHODS
        ):
            raise ArgumentError(
                f"{type(env).__name__} cannot go around a seat, since it is not made from hooks alone: derive it from "
                "gem_core.Wrapper and override before_reset, after_reset, before_step or after_step; or put it around "
                "gem_core.single_agent(env, seat, others)"
            )
        layers.append(env)
        env = env.env
    return layers


@reads_from_env(
    "answer_fences", "answer_tags", "metadata", "render", "render_mode", "env_id", "num_tasks", "endless_tasks"
)
@reads_from_env("np_random", "np_random_seed", "action_random", "seed_actions")
@reads_from_env("possible_agents", "agents", "agent_selector", "max_steps", "add_agent", "observe")
class SeatWrappers(MultiAgentEnv):
    """Puts wrappers around the seats of an environment of several agents; ``make`` does it by ``wrappers``.

    A response passes the wrappers of its seat from the outside in. Where one answers it, as ``ToolEnv`` does a call,
    the seat has the answer and its reward at once, and acts again, while the others wait with the responses that they
    have given. When all who act have a response for the environment, that is stepped, and what each seat hears of it
    passes its wrappers from the inside out. For its wrappers, a seat's first observation is the result of a ``reset``;
    the last observation of a seat that ends before it ever acted does not pass them.

    Where a wrapper ends its seat, as a limit of turns or a failed tool does, all others are truncated, since nobody
    would take its turns.

    Args:
        env: The environment; ``unwrapped`` is the task itself.
        around: Puts wrappers around a seat, by its name. Seats that are left out have none.

    Raises:
        ArgumentError: There is no such seat, or its wrappers are not made from hooks alone.
    """

    def __init__(self, env: MultiAgentEnv, around: Mapping[str, PutAround]) -> None:
        super().__init__()
        self.env = env
        check_seats(around, env.possible_agents)
        self._seats = {
            seat: WrappedSeat(env, seat, *([around[seat]] if seat in around else [])) for seat in env.possible_agents
        }
        self.terminations, self.truncations = {}, {}

    @property
    def unwrapped(self) -> Env:
        """The task itself, without any wrapper."""
        return cast("Env", self.env.unwrapped)

    @property
    def concurrency(self) -> Concurrency:  # type: ignore[override]  # of this instance
        """What the environment and the wrappers of all seats need."""
        return most_demanding(
            concurrency_of(self.env), *(concurrency_of(seat.outermost) for seat in self._seats.values())
        )

    @property
    def spec(self) -> Any:  # type: ignore[override]  # made anew
        """What the environment was made from; ``wrappers`` by seat, or one list where it is the same for all."""
        spec = self.env.spec
        if spec is None:
            return None
        by_seat = {name: cast("Any", seat.outermost.spec).wrappers_of(name) for name, seat in self._seats.items()}
        first, *others = by_seat.values()
        if all(first == other for other in others):
            return dataclasses.replace(spec, wrappers=first)
        return dataclasses.replace(spec, wrappers={seat: layers for seat, layers in by_seat.items() if layers})

    @property
    def acting(self) -> tuple[str, ...]:
        """The agents that act now: the ones without a response for the environment."""
        return tuple(agent for agent in self.env.acting if self._seats[agent].held is None)

    @property
    def cumulative(self) -> dict[str, float]:  # type: ignore[override]  # those of the environment, and more
        """The sum of each agent's rewards in this episode, those of its wrappers included."""
        return {agent: reward + self._seats[agent].added for agent, reward in self.env.cumulative.items()}

    def observation_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]
        """Return the space of an agent's observations, as its wrappers show them."""
        return self._seats[agent].outermost.observation_space

    def action_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]
        """Return the space of an agent's actions."""
        return self._seats[agent].outermost.action_space

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        """Return a valid response of an agent that acts now."""
        return cast("str", self._seats[agent].outermost.get_wrapper_attr("sample_random_action")())

    def gold_action(self, agent: str) -> str | None:  # type: ignore[override]  # an agent has to be named
        """Return a response of an agent that acts now, by which its task is solved."""
        return cast("str | None", self._seats[agent].outermost.get_wrapper_attr("gold_action")())

    def reset(  # type: ignore[override]  # dictionaries by agent
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """Begin an episode; see ``MultiAgentEnv.reset``."""
        return run_without_loop(self.reset_async(seed, options))

    def step(self, actions: Mapping[str, str]) -> JointStepResult:  # type: ignore[override]
        """Answer the responses of all who act now; see ``MultiAgentEnv.step``."""
        return run_without_loop(self.step_async(actions))

    async def reset_async(  # type: ignore[override]
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """``reset`` for code that runs in an event loop, without blocking it."""
        await side_by_side({name: seat.prepare(seed, options) for name, seat in self._seats.items()})
        observations, infos = cast("JointResetResult", await reset_async(self.env, seed, options))
        self.terminations, self.truncations = dict(self.env.terminations), dict(self.env.truncations)
        for agent, observation in observations.items():
            observations[agent], infos[agent] = await self._seats[agent].begin((observation, infos[agent]))
        return observations, infos

    async def step_async(self, actions: Mapping[str, str]) -> JointStepResult:  # type: ignore[override]
        """``step`` for code that runs in an event loop; the wrappers of several seats work side by side."""
        if not self.acting:
            raise reset_needed(self)
        check_actions(self.acting, actions)
        answers = await side_by_side({agent: self._seats[agent].hand_in(action) for agent, action in actions.items()})
        results = {agent: result for agent, result in answers.items() if result is not None}
        if not results:
            results = await self._heard(await step_joint(self.env, self._take_held()))
        if any(results[agent][2] or results[agent][3] for agent in self.env.agents if agent in results):
            results = await self._truncated(results)
        return self._joined(results)

    def _take_held(self) -> dict[str, str]:
        """Return the responses of all who act, which wait no more."""
        held = {agent: cast("str", self._seats[agent].held) for agent in self.env.acting}
        for seat in self._seats.values():
            seat.held = None
        return held

    async def _heard(self, joint: JointStepResult) -> dict[str, StepResult]:
        """Return what each agent hears of a step of the environment, as its wrappers pass it on."""
        return {agent: await self._seats[agent].hear(result_of(joint, agent)) for agent in joint[1]}

    def truncate_all(self) -> JointStepResult:
        """End the episode from outside; see ``MultiAgentEnv.truncate_all``."""
        if not self.acting:
            raise reset_needed(self)
        return self._joined(run_without_loop(self._truncated({})))

    async def _truncated(self, results: Mapping[str, StepResult]) -> dict[str, StepResult]:
        """End the episode for all.

        Args:
            results: Those of the seats that have theirs already; the wrappers of one of them ended it.
        """
        for seat in self._seats.values():
            seat.held = None
        joint = await truncate_joint(self.env)
        for agent in results:
            joint[1].pop(agent, None)  # it has its result already; one that ended before is not there
        cut_off = {
            agent: (observation, reward, terminated, truncated or not terminated, info)
            for agent, (observation, reward, terminated, truncated, info) in results.items()
        }
        return {**cut_off, **await self._heard(joint)}

    def _joined(self, results: Mapping[str, StepResult]) -> JointStepResult:
        for agent in self.env.terminations:  # some may have joined in this step
            self.terminations.setdefault(agent, False)
            self.truncations.setdefault(agent, False)
        observations, rewards, infos = {}, {}, {}
        for agent, (observation, reward, terminated, truncated, info) in results.items():
            rewards[agent], infos[agent] = reward, info
            if agent in self.env.agents:
                observations[agent] = observation
            else:
                info["final_obs"] = observation
                self.terminations[agent], self.truncations[agent] = terminated, truncated
        return observations, rewards, dict(self.terminations), dict(self.truncations), infos

    def close(self) -> None:
        """Close the wrappers of all seats, then the environment."""
        with ExitStack() as closing:
            closing.callback(self.env.close)
            for seat in self._seats.values():
                closing.callback(seat.outermost.close)


async def step_joint(env: MultiAgentEnv, actions: Mapping[str, str]) -> JointStepResult:
    """Step an environment of several agents from a coroutine without blocking its loop."""
    return cast("JointStepResult", await step_async(env, cast("Any", actions)))


async def truncate_joint(env: MultiAgentEnv) -> JointStepResult:
    """End the episode of all agents from a coroutine without blocking its loop."""
    return env.truncate_all() if concurrency_of(env) == "inline" else await in_thread(env.truncate_all)
