"""``single_agent``: one seat of an environment of several agents as an environment of its own."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, Self, cast

from gem_core.background import on_library_loop, run_sync, run_without_loop, side_by_side
from gem_core.env.checks import check_seats, refuse_action, reset_needed
from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv, result_of
from gem_core.env.seats import SeatEnv, reads_from_env, step_joint, truncate_joint
from gem_core.env.seeding import stable_hash
from gem_core.env.wrapper import concurrency_of, most_demanding, reset_async
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.failures import author_frames, failure_info
from gem_core.making.environment import make_from
from gem_core.records.plans import EpisodeStart, PlanItem
from gem_core.registry.lookup import registry
from gem_core.rollouts.agent import Agent, close_agent, is_asynchronous
from gem_core.rollouts.seat import RunningSeat, new_episode
from gem_core.rollouts.seating import Seated, seated
from gem_core.types import Concurrency, ResetResult, Response, StepResult

_MOST_DEALS = 10


class _OpponentError(Exception):
    """The agent at another seat failed."""


@reads_from_env("num_tasks", "endless_tasks")
class SingleAgentEnv(SeatEnv):
    """One seat of an environment of several agents as an environment: the other seats are played inside it.

    ``reset`` and ``step`` let the others act until the seat acts again or has ended. What the seat observes and earns
    is unchanged; a reward that it had before it first acted is added to that of its first step. When the seat has
    ended, the episode is over, whatever the others would still do. Where a game is over before the seat ever acted,
    another is dealt.

    Each of the others has a conversation and a context of its own, as in ``rollout``. Where one fails, or gives no
    text, the episode is truncated with ``info["error"]`` of the kind ``"opponent"``, and in ``reset`` an
    ``EnvFaultError`` is raised: it is never the agent's loss.

    Args:
        env: The environment, which belongs to the new one; or the id of a registered one.
        seat: The seat of the agent that is left.
        others: Who plays the other seats: an agent, or the name of one, as in ``"random"`` or ``"openai:MODEL"``; a
            list of these, of which one is drawn for each episode by its seed; or a mapping of these by seat, where
            seats that are left out are played by ``"random"``. With an asynchronous agent among them the environment
            is asynchronous, and agents that act at once are asked side by side; plain ones are taken to answer at once.
        max_other_turns: Steps without the seat after which an episode counts as failed.
        **kwargs: Keyword arguments of the environment, where ``env`` is an id.

    Raises:
        ArgumentError: There is no such seat; or keyword arguments are given for an environment that is made already.
        UnknownEnvError: There is no such environment.
        UnknownAgentError: There is no agent of that name.
    """

    def __init__(
        self,
        env: MultiAgentEnv | str,
        seat: str,
        others: Any = "random",
        *,
        max_other_turns: int = 300,
        **kwargs: Any,
    ) -> None:
        if isinstance(env, MultiAgentEnv) and kwargs:
            raise ArgumentError(
                f"{', '.join(kwargs)}: keyword arguments go with the id of an environment, and this one is made already"
            )
        if type(max_other_turns) is not int or max_other_turns < 1:
            raise ArgumentError(f"max_other_turns must be a positive whole number, not {max_other_turns!r}")
        made: Any = make_from(registry().env(env), kwargs) if isinstance(env, str) else env
        self._loaded: list[Agent] = []
        try:
            if not isinstance(made, MultiAgentEnv):
                raise ArgumentError(f"single_agent takes an environment of several agents, or its id, not {env!r:.100}")
            super().__init__(made, seat)
            self._players = self._players_of(others)
        except BaseException:
            if made is not env:
                made.close()
            raise
        self._agents = list({id(one.agent): one.agent for each in self._players.values() for one in each}.values())
        self._asynchronous = any(map(is_asynchronous, self._agents))
        self.max_other_turns = max_other_turns
        self._prepared = False
        self._live = False
        self._acting: list[str] = []
        """Who acts now."""
        self._running: dict[str, RunningSeat] = {}
        """The episode of each other seat that has acted, or is to act."""
        self._draws: dict[str, int] = {}
        """How many random actions were drawn for each other seat."""
        self._reward = 0.0
        """What the seat earned and has not been given."""

    shared_by_forks = ("_players", "_agents")

    @property
    def concurrency(self) -> Concurrency:  # type: ignore[override]  # of this instance
        """What the environment and the other agents need."""
        return most_demanding(concurrency_of(self.env), "async" if self._asynchronous else "inline")

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin an episode, and let the others act until it is the seat's turn.

        Raises:
            EnvFaultError: Another agent failed, or the turn of the seat never came.
        """
        return (run_sync if self._asynchronous else run_without_loop)(self.reset_async(seed, options))

    def step(self, action: str) -> StepResult:
        """Answer a response of the seat, and let the others act until it is its turn again."""
        return (run_sync if self._asynchronous else run_without_loop)(self.step_async(action))

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """``reset`` for code that runs in an event loop."""
        super().reset(seed=seed)
        self._live = False
        await self._prepare()
        for deal in range(_MOST_DEALS):
            deal_seed = stable_hash(self.np_random_seed, "deal", deal) if deal else self.np_random_seed
            self._running, self._draws, self._reward = {}, {}, 0.0
            observations, infos = cast("JointResetResult", await reset_async(self.env, deal_seed, options))
            flags = dict.fromkeys(observations, False)
            try:
                joint = (observations, dict.fromkeys(observations, 0.0), flags, flags, infos)
                result = await self._until_own_turn(joint)
            except _OpponentError as error:
                raise EnvFaultError(f"{self._name}: {error}") from error.__cause__
            if result is None:
                continue
            observation, self._reward, terminated, truncated, info = result
            if info.get("error"):
                raise EnvFaultError(f"{self._name}: {_message_of(info['error'])}")
            if not (terminated or truncated):
                info["seed"] = self.np_random_seed
                self._live = True
                return observation, info
        raise EnvFaultError(f"{self._name}: {_MOST_DEALS} games in a row were over before {self.seat!r} acted")

    async def step_async(self, action: str) -> StepResult:
        """``step`` for code that runs in an event loop."""
        if not self._live:
            raise reset_needed(self)
        if not isinstance(action, str):
            refuse_action(action)
        try:
            joint = await self._joint_step({self.seat: action})
            result = cast("StepResult", await self._until_own_turn(joint))
        except _OpponentError as error:
            observation, reward, _, _, info = result_of(await truncate_joint(self.env), self.seat)
            info["error"] = failure_info("opponent", str(error), author_frames(error))
            result = observation, self._take_reward(reward), False, True, info
        self._live = not (result[2] or result[3])
        return result

    async def _until_own_turn(self, joint: JointStepResult) -> StepResult | None:
        """Let the others act until the seat acts or has ended; None if the game is over and the seat was not in it.

        Args:
            joint: The result of the last step.

        Raises:
            _OpponentError: One of the others failed, or they never come to an end.
        """
        for turn in range(self.max_other_turns + 1):
            observations, rewards, _, _, infos = joint
            self._acting = list(observations)
            for agent in rewards:
                if agent != self.seat:
                    self._note(agent, result_of(joint, agent))
            if self.seat in rewards:
                observation, reward, terminated, truncated, info = result_of(joint, self.seat)
                faults = {agent: each["error"] for agent, each in infos.items() if each.get("error")}
                if truncated and faults and "error" not in info:  # at another seat
                    agent, error = next(iter(faults.items()))
                    info["error"] = {"kind": "opponent", "message": f"{agent!r}: {_message_of(error)}"}
                return observation, self._take_reward(reward), terminated, truncated, info
            if not observations:
                return None
            if turn < self.max_other_turns:
                joint = await self._joint_step({})
        raise _OpponentError(f"the turn of {self.seat!r} did not come in {self.max_other_turns} turns of the others")

    async def _joint_step(self, own: Mapping[str, str]) -> JointStepResult:
        """Step the environment with responses of all who act."""
        others = [agent for agent in self._acting if agent != self.seat]
        responses = {**await side_by_side({agent: self._ask(agent) for agent in others}), **own}
        return await step_joint(self.env, {agent: responses[agent] for agent in self._acting})

    def _note(self, agent: str, result: StepResult) -> None:
        """Add the result of a step to the episode of another seat."""
        if agent in self._running:
            self._running[agent].add(*result)
            return
        observation, reward, _, _, info = result
        seed = self.np_random_seed
        start = EpisodeStart(PlanItem(), (seed,), 0, seed, seed)
        record = new_episode({"id": self._name, "kwargs": {}}, start, observation, info)
        record.seat, record.first_reward = agent, reward
        self._running[agent] = RunningSeat(record, self._player(agent), partial(self._draw_for, agent))

    # Asking the others.

    async def _ask(self, agent: str) -> Response:
        """Return the response of the agent at another seat.

        Raises:
            _OpponentError: It failed, or returned no text.
        """
        running = self._running[agent]
        try:
            answer: Any = running.agent(running.conversation.sent(), running.context)
            return await running.read_answer(on_library_loop(answer) if inspect.isawaitable(answer) else answer)
        except (Exception, SystemExit) as error:
            problem = f"the agent at {agent!r} failed: {type(error).__name__}: {error}"
            raise _OpponentError(problem[:500]) from error

    def _take_reward(self, reward: float) -> float:
        """Return a reward with what the seat earned before."""
        reward, self._reward = self._reward + reward, 0.0
        return reward

    async def _prepare(self) -> None:
        """Prepare the other agents before the first episode."""
        if self._prepared:
            return
        for player in self._agents:
            waited = getattr(player, "prepare", lambda: None)()
            if inspect.isawaitable(waited):
                await on_library_loop(waited)
        self._prepared = True

    def _players_of(self, others: Any) -> dict[str, list[Seated]]:
        """Return the agents from which each other seat's is drawn."""
        rest = [agent for agent in self.env.possible_agents if agent != self.seat]
        if not isinstance(others, Mapping):
            others = dict.fromkeys(rest, others)
        if self.seat in others:
            raise ArgumentError(f"others names {self.seat!r}, the seat of the agent itself; leave it out")
        check_seats(others, rest)
        return {agent: self._candidates(others.get(agent, "random")) for agent in rest}

    def _candidates(self, given: Any) -> list[Seated]:
        several = isinstance(given, list | tuple) and not isinstance(given, Seated)
        if several and not given:
            raise ArgumentError("others names no agent for a seat; give one, as 'random'")
        names = given if several else [given]
        found = list(map(seated, names))
        self._loaded += [one.agent for name, one in zip(names, found, strict=True) if isinstance(name, str)]
        return found

    def _player(self, agent: str) -> Seated:
        """Return who plays another seat in this episode."""
        players = self._players[agent]
        return players[stable_hash(self.np_random_seed, "player", agent) % len(players)]

    def task_row(self, index: int) -> Mapping[str, Any]:
        """Return what the environment knows of a task; see ``Env.task_row``."""
        return self.env.task_row(index)

    # Random actions. The environment has one generator for all seats, which is started anew for each action, so that
    # drawing one for a seat never changes what others draw.

    def _draw_for(self, agent: str) -> str:
        self._draws[agent] = number = self._draws.get(agent, 0) + 1
        self.env.seed_actions(stable_hash(self.env.np_random_seed, "actions", agent, number))
        return self.env.sample_random_action(agent)

    def sample_random_action(self) -> str:
        """Return a valid response of the seat in the present state; see ``Env.sample_random_action``."""
        self.env.seed_actions(int(self.action_random.integers(2**53)))
        return self.env.sample_random_action(self.seat)

    # State and the rest.

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        memo[id(self._loaded)] = []  # a fork asks the same agents, and leaves it to the first one to close them
        return super().__deepcopy__(memo)

    def close(self) -> None:
        """Close the environment, and the agents that were given by name."""
        with ExitStack() as closing:
            closing.callback(self.env.close)
            for player in self._loaded:
                closing.callback(close_agent, player)

    @property
    def _name(self) -> str:
        return self.env_id or self.env.env_id or type(self.env.unwrapped).__name__


single_agent = SingleAgentEnv
"""The way to make one."""


def _message_of(error: object) -> object:
    return error.get("message") if isinstance(error, Mapping) else error
