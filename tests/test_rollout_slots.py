"""What ``rollout`` promises of its slots: exact counts, backpressure, faults, and every mode of autoreset."""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter
from typing import Any

import pytest
from held_envs import GATES, KINDS, LONG_S, register_held
from toys import CountdownEnv, sampling_agent
from vector_envs import INLINE

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError, FaultBudgetError, RequestError, SamplingNotSupported
from gem_core.records.plans import PlanItem
from gem_core.rollouts.agent import Context

COUNTDOWN = "toy:Countdown-v0"
ECHO = "toy:Echo-v0"


@pytest.fixture(autouse=True)
def _held() -> None:
    register_held()


class Unsampled(CountdownEnv):
    """Its ``sample_random_action`` fails in the second turn of the episodes with these seeds."""

    def sample_random_action(self) -> str:
        if self.turn == 1 and (not self.fail_seeds or self.np_random_seed in self.fail_seeds):
            raise RuntimeError("no idea")
        return "a"


def by_key(episodes: Any) -> list[gem.Episode]:
    return sorted(episodes, key=lambda episode: (int(episode.key), episode.repeat))


async def answer_a(observation: gem.Observation, context: Context) -> str:
    await asyncio.sleep(0)
    return "a"


# Exact counts.


@pytest.mark.few(4)
@pytest.mark.parametrize("agent", [sampling_agent, answer_a], ids=["plain", "asynchronous"])
@pytest.mark.parametrize("num_envs", [2, 16])
@pytest.mark.parametrize("backend", ["sync", "async", "process"])
def test_every_episode_of_the_plan_comes_out_once(backend: str, num_envs: int, agent: Any) -> None:
    """However long each takes: short ones are not over-represented, and none is cut off or added."""
    lengths = [1, 30, 1, 1, 2, 25, 1, 1, 1, 3, 1, 20]
    plan = [PlanItem(id=COUNTDOWN, options={"left": length}, repeat=1 + length % 2) for length in lengths]
    with gem.make_vec(COUNTDOWN, num_envs, backend=backend, seed=3) as vector:
        episodes = by_key(gem.rollout(vector, agent, plan=plan))
    asked = [(str(place), repeat) for place, item in enumerate(plan) for repeat in range(item.repeat)]
    assert [(episode.key, episode.repeat) for episode in episodes] == asked
    assert [episode.turns for episode in episodes] == [lengths[int(key)] for key, _ in asked]


@pytest.mark.parametrize("num_envs", [1, 2, 3, 8])
def test_each_environment_gets_the_number_of_episodes_asked_for(num_envs: int) -> None:
    """Where one ends at once and the other takes long."""

    def agent(observation: str, context: Context) -> str:
        return "stop" if context.env_id == ECHO and context.turn == 40 else "a"

    vector = gem.make_vec([COUNTDOWN, ECHO], num_envs, seed=0)
    counts = Counter(episode.id for episode in gem.rollout(vector, agent, episodes=5))
    assert counts == {COUNTDOWN: 5, ECHO: 5}


# Backpressure.


def test_plain_agent_is_not_asked_while_an_episode_is_looked_at() -> None:
    """Neither asked nor stepped ahead."""
    asked: list[str] = []

    def agent(observation: gem.Observation, context: Context) -> str:
        asked.append(context.episode)
        return "a"

    plan = [PlanItem(options={"left": 1})] * 6
    for number, _ in enumerate(gem.rollout(gem.make_vec(COUNTDOWN, 2, seed=0), agent, plan=plan)):
        assert len(asked) <= 2 + number


# Every mode of autoreset.


# Faults.


@pytest.mark.few(1)
@pytest.mark.parametrize("backend", ["sync", "async", "process"])
@pytest.mark.parametrize("asynchronous", [True, False], ids=["asynchronous", "plain"])
def test_an_action_that_cannot_be_sampled_costs_its_episode_alone(backend: str, asynchronous: bool) -> None:
    """It is the environment's fault, whoever asked."""
    gem.register("slots:Unsampled-v0", Unsampled)
    plan = [PlanItem(seed=seed, options={"left": 3}) for seed in range(6)]

    async def waiting(observation: gem.Observation, context: Context) -> str:
        return context.sample_random_action()

    agent = waiting if asynchronous else sampling_agent
    with gem.make_vec("slots:Unsampled-v0", 2, backend=backend, fail_seeds=(1, 4), seed=0) as vector:
        episodes = by_key(gem.rollout(vector, agent, plan=plan))
        assert vector.faults == 2
    errors = [episode.error and episode.error["message"] for episode in episodes]
    error = "sample_random_action raised RuntimeError: no idea"
    assert errors == [None, error, None, None, error, None]
    assert [episode.turns for episode in episodes] == [3, 1, 3, 3, 1, 3]
    assert episodes[1].transitions[-1].truncated


def test_actions_that_can_never_be_sampled_stop_the_run() -> None:
    """Under the budget of faults, whose advice is about the environment, and whose cause is the last fault."""
    gem.register("slots:Unsampled-v0", Unsampled)
    plan = [PlanItem(options={"left": 3})] * 50
    with pytest.raises(FaultBudgetError) as caught:
        list(gem.rollout("slots:Unsampled-v0", sampling_agent, plan=plan, seed=0))
    assert str(caught.value).startswith("17 faults in a row")
    assert "Mend the environment" in str(caught.value)
    assert isinstance(caught.value.__cause__, EnvFaultError)


def test_action_that_cannot_be_sampled_is_raised_where_that_was_asked_for() -> None:
    """By ``on_error="raise"``, as every fault of an environment; what an agent lacks still costs its episode alone."""
    gem.register("slots:Unsampled-v0", Unsampled)
    plan = [PlanItem(options={"left": 3})] * 2
    vector = gem.make_vec("slots:Unsampled-v0", 1, on_error="raise", seed=0)
    with pytest.raises(EnvFaultError, match="no idea"):
        list(gem.rollout(vector, sampling_agent, plan=plan))

    def unreachable(observation: gem.Observation) -> str:
        raise RequestError("the server is down")

    errors = [episode.error for episode in gem.rollout(vector, unreachable, plan=plan)]
    assert errors == [{"kind": "agent", "message": "the server is down"}] * 2


def test_environment_without_sampling_stops_the_run_by_its_own_error() -> None:
    """No fault: another agent is needed."""
    with pytest.raises(SamplingNotSupported):
        list(gem.rollout(ECHO, sampling_agent, episodes=3, seed=0))


def test_a_hang_is_given_up_although_nobody_waits() -> None:
    """Where there is always something else to do, as for ``recv`` without waiting."""
    plan = [PlanItem(kwargs={"gate": "never"})]
    with gem.make_vec(KINDS["thread"], 1, plan=plan, step_timeout=0.05, seed=0) as vector:
        vector.reset()
        vector.send(["a"])
        limit = time.monotonic() + LONG_S
        while not (received := vector.recv(min_envs=0)).slots:
            assert time.monotonic() < limit
        assert received.infos[0]["final_info"]["error"]["kind"] == "timeout"
        GATES["never"].set()


@pytest.mark.parametrize("backend", ["sync", "async", "process"])
def test_looking_at_an_environment_does_not_disturb_it(backend: str) -> None:
    """Its record names the wrappers; one with arguments of its own is not made anew for that."""
    plan = [PlanItem(kwargs={"longest": 5 + place}) for place in range(6)]
    with gem.make_vec(COUNTDOWN, 2, backend=backend, wrappers="concat,episode_stats", seed=1) as vector:
        episodes = by_key(gem.rollout(vector, sampling_agent, plan=plan))
    assert [episode.error for episode in episodes] == [None] * 6
    assert [episode.kwargs for episode in episodes] == [item.kwargs for item in plan]
    assert {str(episode.wrappers) for episode in episodes} == {"[['concat', {}], ['episode_stats', {}]]"}


def test_rollout_of_an_id_asks_an_asynchronous_agent_for_many_episodes_at_once() -> None:
    """As many as it may be asked, or as ``num_envs`` says; a plain agent one at a time."""

    class Counting:
        def __init__(self, expected: int) -> None:
            self.expected = expected
            self.open = self.most = 0
            self.reached = asyncio.Event()

        async def __call__(self, observation: gem.Observation) -> str:
            self.open += 1
            self.most = max(self.most, self.open)
            if self.open >= self.expected:
                self.reached.set()
            await asyncio.wait_for(self.reached.wait(), LONG_S)
            self.open -= 1
            return "a"

    def most(expected: int, **options: Any) -> int:
        agent = Counting(expected)
        list(gem.rollout(COUNTDOWN, agent, episodes=70, seed=1, **options))
        return agent.most

    assert (most(64), most(3, num_envs=3), most(5, max_requests=5)) == (64, 3, 5)
    Counting.max_concurrency = 7  # type: ignore[attr-defined]
    assert most(7) == 7


def test_a_backend_and_a_number_of_environments_are_for_ids() -> None:
    """With its options; what is made already lives somewhere."""
    (episode,) = gem.rollout(INLINE, lambda observation: "!pid", episodes=1, seed=1, backend="process:workers=1")
    assert episode.transitions[0].info["pid"] != os.getpid()
    for option in ({"backend": "process"}, {"num_envs": 2}):
        with pytest.raises(ArgumentError, match=next(iter(option))):
            list(gem.rollout(gem.make_vec(INLINE, 1), lambda observation: "a", episodes=1, **option))  # type: ignore[arg-type]


def test_vector_environment_that_cannot_be_made_raises_in_the_caller() -> None:
    """By the first episode that is asked for."""

    async def main() -> None:
        await anext(gem.arollout("toy:Nothing", lambda observation: "a"))

    with pytest.raises(gem.GemError, match="no environment 'toy:Nothing'"):
        asyncio.run(main())
