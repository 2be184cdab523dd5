"""``rollout``: the one loop, its agents and its records."""

from __future__ import annotations

import asyncio
import os
import threading
from typing import Any

import gymnasium
import pytest
from held_envs import LONG_S, register_held
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import CountdownEnv, Notebook, by_key, sampling_agent
from vector_envs import INLINE

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import (
    AgentError,
    ArgumentError,
    ContextOverflowError,
    EnvFaultError,
    FaultBudgetError,
    RequestError,
    SamplingNotSupported,
)
from gem_core.records.plans import PlanItem, group_plan
from gem_core.rollouts.agent import Context, as_agent, close_agent
from gem_core.tools.env import ToolEnv

COUNTDOWN = "toy:Countdown-v0"
SUMS = "toy:Sums-v0"
ECHO = "toy:Echo-v0"


@pytest.fixture(autouse=True)
def _held() -> None:
    register_held()


@settings(deadline=None, max_examples=20)
@given(num_envs=st.integers(1, 9), seed=st.integers(0, 2**53))
def test_the_same_seed_gives_the_same_episodes_whatever_the_number_of_slots(num_envs: int, seed: int) -> None:
    """Ids, seeds, observations, actions and rewards; another seed gives others."""
    ids = [COUNTDOWN, SUMS]
    alone = by_key(gem.rollout(gem.make_vec(ids, 2, seed=seed), sampling_agent, episodes=6))
    among = gem.make_vec(ids, num_envs, seed=seed)
    assert by_key(gem.rollout(among, sampling_agent, episodes=6)) == alone
    assert len(alone) == 12
    assert by_key(gem.rollout(gem.make_vec(ids, 2, seed=seed + 1), sampling_agent, episodes=6)) != alone
    assert alone[0].versions["gem-core"] == gem.__version__


def test_an_episode_is_replayed_from_its_record() -> None:
    """Id, arguments, wrappers, seed, options and actions are enough."""
    vector = gem.make_vec([COUNTDOWN, SUMS], 3, wrappers="concat,episode_stats", seed=1)
    for episode in gem.rollout(vector, sampling_agent, episodes=5):
        env = gem.make(episode.id, wrappers=[tuple(wrapper) for wrapper in episode.wrappers], **episode.kwargs)
        observation, _ = (
            env.reset(seed=episode.seed, options=dict(episode.options))
            if episode.options
            else env.reset(seed=episode.seed)
        )
        assert observation == episode.observation
        for turn in episode.transitions:
            assert turn.observation == observation
            observation, reward, terminated, truncated, _ = env.step(turn.action)
            assert (reward, terminated, truncated) == (turn.reward, turn.terminated, turn.truncated)
        assert observation == episode.final_observation


def test_a_data_set_is_covered_once_in_order_by_default() -> None:
    """And ten episodes of what has no rows."""
    episodes = by_key(gem.rollout([SUMS, COUNTDOWN], sampling_agent, seed=0))
    assert [episode.info["task_id"] for episode in episodes if episode.id == SUMS] == [str(row) for row in range(7)]
    assert sum(episode.id == COUNTDOWN for episode in episodes) == 10


def test_groups_start_alike_and_act_apart() -> None:
    """As GRPO needs them."""
    plan = group_plan([PlanItem(options={"left": 3}), PlanItem(options={"left": 3})], 4)
    episodes = by_key(gem.rollout(gem.make_vec(COUNTDOWN, 3, seed=0), sampling_agent, plan=plan))
    assert [episode.group for episode in episodes] == ["0"] * 4 + ["1"] * 4
    assert len({(episode.seed, str(episode.observation)) for episode in episodes[:4]}) == 1
    assert len({tuple(turn.action for turn in episode.transitions) for episode in episodes}) == 8


def test_context_tells_the_agent_where_it_is() -> None:
    """Turn, group, info, and its own earlier responses as they were sampled."""
    seen: list[tuple[Any, ...]] = []

    def agent(observation: gem.Observation, context: Context) -> gem.Response:
        seen.append((context.episode, context.turn, context.group, context.info["suffix"], len(context.responses)))
        assert all(response.token_ids == [turn] for turn, response in enumerate(context.responses))
        return gem.Response("a", token_ids=[context.turn])

    list(gem.rollout(gem.make(COUNTDOWN), agent, plan=[PlanItem(options={"left": 2}, repeat=2)], seed=0))
    assert seen == [
        ("0.0", 0, "0", "Left: 2.", 0),
        ("0.0", 1, "0", "Left: 1.", 1),
        ("0.1", 0, "0", "Left: 2.", 0),
        ("0.1", 1, "0", "Left: 1.", 1),
    ]


def test_tools_are_in_the_context_and_the_record() -> None:
    """Schemas for the agent, names for the record."""
    env = ToolEnv(CountdownEnv(), [Notebook()])
    (episode,) = gem.rollout(env, lambda _, context: context.tools[0]["function"]["name"], episodes=1, seed=0)
    assert episode.tools == ["note"]
    assert {str(turn.action) for turn in episode.transitions} == {"note"}


def test_a_slow_answer_holds_up_only_its_own_slot() -> None:
    """The other slots finish all their episodes while one waits."""
    release = threading.Event()
    finished: list[str] = []

    async def agent(observation: gem.Observation, context: Context) -> str:
        while context.episode == "0.0" and not release.is_set():
            await asyncio.sleep(0)
        return "a"

    for episode in gem.rollout(gem.make_vec(COUNTDOWN, 3, seed=0), agent, episodes=9):
        finished.append(episode.key)
        if len(finished) == 8:
            release.set()
    assert finished[-1] == "0"
    assert sorted(finished) == [str(key) for key in range(9)]


@pytest.mark.parametrize("asynchronous", [True, False])
def test_a_request_that_fails_is_an_error_of_its_episode(asynchronous: bool) -> None:
    """Counted apart, with the turns that were taken; every plan item still gives one episode."""

    def plain(observation: gem.Observation, context: Context) -> str:
        if context.episode == "1.0" or (context.episode == "2.0" and context.turn == 1):
            raise RequestError("the server is down")
        return "a"

    async def waiting(observation: gem.Observation, context: Context) -> str:
        return plain(observation, context)

    plan = [PlanItem(options={"left": 3})] * 4
    run = gem.rollout(gem.make_vec(COUNTDOWN, 2, seed=0), waiting if asynchronous else plain, plan=plan)
    episodes = by_key(run)
    assert [episode.turns for episode in episodes] == [3, 0, 1, 3]
    assert [episode.error for episode in episodes] == [
        None,
        {"kind": "agent", "message": "the server is down"},
        {"kind": "agent", "message": "the server is down"},
        None,
    ]
    assert episodes[2].transitions[-1].truncated is True


def test_a_history_too_long_for_the_model_truncates_and_is_scored() -> None:
    """No error, no fault, and no action that was never sampled, however many episodes end so."""

    def agent(observation: gem.Observation, context: Context) -> str:
        if context.turn == 1:
            raise ContextOverflowError("too long")
        return "a"

    plan = [PlanItem(options={"left": 3})] * 40
    episodes = list(gem.rollout(COUNTDOWN, agent, plan=plan, seed=0))
    assert len(episodes) == 40
    for episode in episodes:
        assert (episode.turns, episode.error, episode.episode_return) == (1, None, 1.0)
        assert (episode.transitions[-1].truncated, episode.final_info["context_overflow"]) == (True, True)


def test_a_server_that_never_answers_stops_the_run() -> None:
    """Under the budget of faults."""

    def agent(observation: gem.Observation) -> str:
        raise RequestError("the server is down")

    with pytest.raises(FaultBudgetError, match=r"the server is down.*agent that fails"):
        list(gem.rollout(COUNTDOWN, agent, episodes=100, seed=0))


def test_prepare_is_called_before_the_first_episode() -> None:
    """Plain or a coroutine function; what it raises is raised at the start."""
    called: list[str] = []

    class Prepared:
        async def prepare(self) -> None:
            called.append("prepare")

        def __call__(self, observation: gem.Observation) -> str:
            called.append("ask")
            return "a"

        def close(self) -> None:
            called.append("close")

    agent = as_agent(Prepared())
    list(gem.rollout(COUNTDOWN, agent, episodes=1, seed=0))
    close_agent(agent)
    assert (called[0], set(called[1:-1]), called[-1]) == ("prepare", {"ask"}, "close")


def test_an_abandoned_run_cancels_what_is_open() -> None:
    """No coroutine is left behind."""
    cancelled = threading.Event()

    async def agent(observation: gem.Observation, context: Context) -> str:
        if context.episode != "0.0":
            try:
                await asyncio.Event().wait()
            finally:
                cancelled.set()
        return "a"

    run = gem.rollout(gem.make_vec(COUNTDOWN, 2, seed=0), agent, episodes=2)
    next(run)
    run.close()  # type: ignore[attr-defined]  # it is a generator
    assert cancelled.wait(30)


def test_plan_and_episodes_together_are_refused() -> None:
    """Before anything runs."""
    with pytest.raises(ArgumentError, match="plan"):
        gem.rollout(COUNTDOWN, sampling_agent, plan=[], episodes=3)
    with pytest.raises(ArgumentError, match="-1"):
        gem.rollout(COUNTDOWN, sampling_agent, episodes=-1)


def test_what_is_no_environment_is_refused() -> None:
    """The message says what is one."""
    with pytest.raises(ArgumentError, match="not None"):
        list(gem.rollout(None, lambda observation: "", episodes=1))  # type: ignore[arg-type]  # that is the point
    with pytest.raises(ArgumentError, match=r"gem_core\.Env"):
        list(gem.rollout(gymnasium.Env(), lambda observation: "", episodes=1))


def test_an_agent_that_returns_no_text_is_named() -> None:
    """It is a mistake of the program, not an answer."""
    with pytest.raises(AgentError, match="this one returned NoneType"):
        list(gem.rollout(COUNTDOWN, lambda observation: None, episodes=1))


@pytest.mark.parametrize("agent", [3, "random", lambda: "a", lambda a, b, c: "a"])
def test_what_cannot_be_called_as_an_agent_is_refused(agent: Any) -> None:
    """The error says how an agent is called."""
    with pytest.raises(AgentError, match="an agent"):
        as_agent(agent)


def test_environment_that_was_given_stays_open_and_its_replacement_does_not() -> None:
    """Whoever made an environment closes it; also when the rollout is abandoned."""
    made: list[CountdownEnv] = []

    class Noted(CountdownEnv):
        def __init__(self, fail_seeds: tuple[int, ...] = ()) -> None:
            super().__init__(fail="step" if fail_seeds else "", fail_seeds=fail_seeds)
            made.append(self)

    list(gem.rollout(Noted(), sampling_agent, episodes=2))
    assert [env.closed for env in made] == [0]
    made.clear()
    running = gem.rollout(Noted((1,)), sampling_agent, plan=[PlanItem(seed=1), PlanItem(seed=2, options={"left": 1})])
    assert next(running).error is not None
    next(running)
    running.close()  # type: ignore[attr-defined]  # it is a generator
    assert [env.closed for env in made] == [0, 1]
    made.clear()
    gem.register("noted:Env-v0", Noted)
    with gem.make_vec("noted:Env-v0", 2, seed=0) as vector:
        list(gem.rollout(vector, sampling_agent, episodes=4))
        assert [env.closed for env in made] == [1, 1], "a slot without another episode keeps no environment"


def test_plan_of_a_vector_environment_is_used_from_its_beginning() -> None:
    """As ``make_vec`` was told; afterwards the vector environment goes on with episodes of its own."""
    vector = gem.make_vec(COUNTDOWN, 2, plan=[PlanItem(options={"left": 2})] * 3, seed=1)
    vector.reset()
    first = by_key(gem.rollout(vector, sampling_agent))
    assert [episode.turns for episode in first] == [2, 2, 2]
    assert by_key(gem.rollout(vector, sampling_agent)) == first
    free = gem.make_vec(COUNTDOWN, 2, seed=1)
    list(gem.rollout(free, sampling_agent, episodes=1))
    assert not any(info.get("idle") for info in free.reset()[1])


def test_option_of_an_agent_is_not_its_context() -> None:
    """A function of the observation may have options of its own; one that is named context gets it."""
    given: list[Any] = []

    def optional(observation: gem.Observation, temperature: float = 0.7) -> str:
        given.append(temperature)
        return "a"

    def named(observation: gem.Observation, context: Context | None = None) -> str:
        given.append(type(context))
        return "a"

    plan = [PlanItem(options={"left": 1})]
    for agent in (optional, named):
        list(gem.rollout(COUNTDOWN, agent, plan=plan))
    assert given == [0.7, Context]


def test_a_run_collected_on_the_library_loop_closes_what_it_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The garbage collector runs in any thread."""
    closed = threading.Event()
    close = gem.VectorEnv.close
    monkeypatch.setattr(gem.VectorEnv, "close", lambda self: (close(self), closed.set())[0])
    runs = [gem.rollout(COUNTDOWN, sampling_agent, episodes=2)]
    next(runs[0])

    async def forget() -> None:
        runs.clear()

    run_sync(forget())
    assert closed.wait(30)


def test_an_agent_may_be_given_by_name() -> None:
    """As in ``gem run``; a name that nobody has is an error that lists those there are."""
    assert all(episode.error is None for episode in gem.rollout(COUNTDOWN, "random", episodes=2, seed=1))
    with pytest.raises(gem.errors.UnknownAgentError, match="Did you mean 'random'"):
        gem.rollout(COUNTDOWN, "randon", episodes=2)


class Unsampled(CountdownEnv):
    """Its ``sample_random_action`` fails in the second turn of the episodes with these seeds."""

    def sample_random_action(self) -> str:
        if self.turn == 1 and (not self.fail_seeds or self.np_random_seed in self.fail_seeds):
            raise RuntimeError("no idea")
        return "a"


async def answer_a(observation: gem.Observation, context: Context) -> str:
    await asyncio.sleep(0)
    return "a"


# Exact counts.


@pytest.mark.few(3)
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


# Faults.


@pytest.mark.parametrize("backend", ["sync", "process"])
@pytest.mark.parametrize("asynchronous", [True, False], ids=["asynchronous", "plain"])
@pytest.mark.few(2)
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
    assert "environment" in str(caught.value)
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


@pytest.mark.parametrize("backend", ["sync", "process"])
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
