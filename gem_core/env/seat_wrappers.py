"""``SeatWrappers``: wrappers around the single seats of an environment of several agents."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, cast

from gem_core.background import run_without_loop
from gem_core.env.base import Env
from gem_core.env.joint_calls import AroundEnv, AwaitedCalls, PlainCalls, of_env
from gem_core.env.joint_checks import check_actions, check_in_episode, check_seats
from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv, result_of
from gem_core.env.seat_stack import SeatEnv, SeatStack
from gem_core.env.wrapper import AnyEnv, concurrency_of, most_demanding
from gem_core.types import Concurrency, StepResult

if TYPE_CHECKING:
    from gymnasium import spaces

PutAround = Callable[[SeatEnv], AnyEnv]
"""Puts wrappers around the environment as one seat sees it."""


class SeatWrappers(AroundEnv, MultiAgentEnv):
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
        self._around = around
        seats = {seat: SeatEnv(env, seat) for seat in env.possible_agents}
        self._stacks = {name: SeatStack(around[name](seat) if name in around else seat) for name, seat in seats.items()}
        self._held: dict[str, str] = {}
        """Responses that wait for those of others."""
        self._added: dict[str, float] = {}
        """What the wrappers added to the rewards of each seat in this episode."""
        self.terminations, self.truncations = {}, {}

    possible_agents = of_env("possible_agents")
    agents = of_env("agents")
    agent_selector = of_env("agent_selector")
    max_steps = of_env("max_steps")
    add_agent = of_env("add_agent")
    observe = of_env("observe")
    num_tasks = of_env("num_tasks")
    endless_tasks = of_env("endless_tasks")
    np_random = of_env("np_random")
    np_random_seed = of_env("np_random_seed")
    action_random = of_env("action_random")
    seed_actions = of_env("seed_actions")
    env_id = of_env("env_id")

    @property
    def unwrapped(self) -> Env:
        """The task itself, without any wrapper."""
        return cast("Env", self.env.unwrapped)

    @property
    def concurrency(self) -> Concurrency:  # type: ignore[override]  # of this instance
        """What the environment and the wrappers of all seats need."""
        return most_demanding(concurrency_of(self.env), *(concurrency_of(stack.env) for stack in self._stacks.values()))

    @property
    def spec(self) -> Any:  # type: ignore[override]  # made anew
        """What the environment was made from; ``wrappers`` by seat, or one list where it is the same for all."""
        spec = self.env.spec
        if spec is None:
            return None
        by_seat = {seat: cast("Any", stack.env.spec).wrappers_of(seat) for seat, stack in self._stacks.items()}
        first, *others = by_seat.values()
        if all(first == other for other in others):
            return dataclasses.replace(spec, wrappers=first)
        return dataclasses.replace(spec, wrappers={seat: layers for seat, layers in by_seat.items() if layers})

    @property
    def acting(self) -> tuple[str, ...]:
        """Who has to act now: those that have not given a response for the environment."""
        return tuple(agent for agent in self.env.acting if agent not in self._held)

    @property
    def cumulative(self) -> dict[str, float]:  # type: ignore[override]  # those of the environment, and more
        """The sum of each agent's rewards in this episode, those of its wrappers included."""
        return {agent: reward + self._added[agent] for agent, reward in self.env.cumulative.items()}

    def observation_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]
        """Return the space of an agent's observations, as its wrappers show them."""
        return self._stacks[agent].env.observation_space

    def action_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]
        """Return the space of an agent's actions."""
        return self._stacks[agent].env.action_space

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        """Return a valid response of an agent that acts now."""
        return cast("str", self._stacks[agent].env.get_wrapper_attr("sample_random_action")())

    def gold_action(self, agent: str) -> str | None:  # type: ignore[override]  # an agent has to be named
        """Return a response of an agent that acts now, by which its task is solved."""
        return cast("str | None", self._stacks[agent].env.get_wrapper_attr("gold_action")())

    def reset(  # type: ignore[override]  # dictionaries by agent
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """Begin an episode; see ``MultiAgentEnv.reset``."""
        return run_without_loop(self._reset(seed, options, PlainCalls()))

    def step(self, actions: Mapping[str, str]) -> JointStepResult:  # type: ignore[override]
        """Answer the responses of all who act now; see ``MultiAgentEnv.step``."""
        return run_without_loop(self._step(actions, PlainCalls()))

    async def reset_async(  # type: ignore[override]
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """``reset`` for code that runs in an event loop, without blocking it."""
        return await self._reset(seed, options, AwaitedCalls())

    async def step_async(self, actions: Mapping[str, str]) -> JointStepResult:  # type: ignore[override]
        """``step`` for code that runs in an event loop; the wrappers of several seats work side by side."""
        return await self._step(actions, AwaitedCalls())

    async def _reset(self, seed: int | None, options: dict[str, Any] | None, calls: PlainCalls) -> JointResetResult:
        self._held = {}
        await calls.together({seat: stack.before_reset(seed, options, calls) for seat, stack in self._stacks.items()})
        observations, infos = await calls.reset(self.env, seed, options)
        self._added = dict.fromkeys(self._stacks, 0.0)
        self.terminations, self.truncations = dict(self.env.terminations), dict(self.env.truncations)
        for agent, observation in observations.items():
            observations[agent], infos[agent] = await self._stacks[agent].first((observation, infos[agent]), calls)
        return observations, infos

    async def _step(self, actions: Mapping[str, str], calls: PlainCalls) -> JointStepResult:
        check_actions(self.env_id or type(self.unwrapped).__name__, self.acting, actions)
        jobs = {agent: self._stacks[agent].respond(action, calls) for agent, action in actions.items()}
        results: dict[str, StepResult] = {}
        for agent, outcome in (await calls.together(jobs)).items():
            if isinstance(outcome, str):
                self._held[agent] = outcome
            else:
                results[agent] = outcome
                self._added[agent] += outcome[1]
        if not results:
            held, self._held = self._held, {}
            results = await self._heard(
                await calls.step(self.env, {agent: held[agent] for agent in self.env.acting}), calls
            )
        if any(results[agent][2] or results[agent][3] for agent in self.env.agents if agent in results):
            results = await self._truncated(results, calls)
        return self._joined(results)

    async def _heard(self, joint: JointStepResult, calls: PlainCalls) -> dict[str, StepResult]:
        """Return what each agent hears of a step of the environment, as its wrappers pass it on."""
        results: dict[str, StepResult] = {}
        for agent, reward in joint[1].items():
            results[agent] = await self._stacks[agent].hear(result_of(joint, agent), calls)
            self._added[agent] += results[agent][1] - reward
        return results

    def truncate_all(self) -> JointStepResult:
        """End the episode from outside; see ``MultiAgentEnv.truncate_all``."""
        check_in_episode(self.env_id or type(self.unwrapped).__name__, bool(self.acting))
        return self._joined(run_without_loop(self._truncated({}, PlainCalls())))

    async def _truncated(self, results: Mapping[str, StepResult], calls: PlainCalls) -> dict[str, StepResult]:
        """End the episode for all.

        Args:
            results: Those of the seats that have theirs already; the wrappers of one of them ended it.
            calls: How the environment is called.
        """
        self._held = {}
        joint = await calls.truncate_all(self.env)
        for agent in results:
            joint[1].pop(agent, None)  # it has its result already; one that ended before is not there
        cut_off = {
            agent: (observation, reward, terminated, truncated or not terminated, info)
            for agent, (observation, reward, terminated, truncated, info) in results.items()
        }
        return {**cut_off, **await self._heard(joint, calls)}

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

    def spawn(self, **overrides: Any) -> SeatWrappers:
        """Return another instance, wrappers included; see ``Env.spawn``."""
        return SeatWrappers(cast("MultiAgentEnv", self.env.spawn(**overrides)), self._around)

    def close(self) -> None:
        """Close the wrappers of all seats, then the environment."""
        with ExitStack() as closing:
            closing.callback(self.env.close)
            for stack in self._stacks.values():
                closing.callback(stack.env.close)
