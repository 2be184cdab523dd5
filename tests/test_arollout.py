"""``arollout``: the agent on the caller's loop, and nothing that waits for anything but its own slot."""

from __future__ import annotations

import asyncio
import gc
import os
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest
from held_envs import BEGUN, GATES, KINDS, LONG_S, register_held
from toys import by_key, sampling_agent

import gem_core as gem
from gem_core.background import background_loop
from gem_core.errors import ArgumentError, EnvFaultError, RequestError
from gem_core.records.plans import PlanItem
from gem_core.rollouts.agent import Context

T = TypeVar("T")

COUNTDOWN = "toy:Countdown-v0"


@pytest.fixture(autouse=True)
def _held() -> None:
    register_held()


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine in a loop of its own, which reports what is wrong with its tasks."""
    complaints: list[dict[str, Any]] = []

    async def watched() -> T:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        try:
            return await asyncio.wait_for(coroutine, LONG_S)
        finally:
            gc.collect()

    result = asyncio.run(watched())
    assert complaints == []
    return result


async def collected(episodes: AsyncIterator[gem.Episode]) -> list[gem.Episode]:
    return by_key([episode async for episode in episodes])


def lasting(*turns: int) -> list[PlanItem]:
    return [PlanItem(options={"left": count}) for count in turns]


@contextmanager
def a_busy_loop_lets_go(begin: asyncio.Event, let_go: Callable[[], object]) -> Iterator[None]:
    """Take turns on the loop, once it has begun, and then let an environment go on that holds something up.

    Whoever blocks the loop for that environment is stuck, until a thread frees it and the test fails.
    """
    stuck: list[str] = []

    async def tick() -> None:
        await begin.wait()
        for _ in range(100):
            await asyncio.sleep(0)
        let_go()

    ticking = asyncio.create_task(tick())
    rescue = threading.Timer(LONG_S / 2, lambda: (stuck.append("the loop was blocked"), let_go()))
    rescue.start()
    yield
    rescue.cancel()
    assert stuck == []
    assert ticking.done()


async def answer_a(observation: gem.Observation, context: Context) -> str:
    await asyncio.sleep(0)
    return "a"


# Where things run.


@pytest.mark.parametrize("kind", KINDS)
def test_agent_runs_on_the_loop_of_the_caller_whatever_the_environment(kind: str) -> None:
    """Where its connections are, from ``prepare`` on; environments run elsewhere."""
    loops: list[asyncio.AbstractEventLoop] = []

    class Agent:
        async def prepare(self) -> None:
            loops.append(asyncio.get_running_loop())

        async def __call__(self, observation: gem.Observation, context: Context) -> str:
            loops.append(asyncio.get_running_loop())
            return context.sample_random_action()

    async def main() -> None:
        plan = lasting(1, 1, 1, 1)
        episodes = await collected(gem.arollout(gem.make_vec(KINDS[kind], 2, seed=0), Agent(), plan=plan))
        assert [episode.error for episode in episodes] == [None] * 4
        assert loops == [asyncio.get_running_loop()] * 5

    run(main())


@pytest.mark.parametrize(("agent", "backend"), [(sampling_agent, "async"), (answer_a, "process")])
def test_episodes_are_those_of_rollout_in_every_backend(backend: str, agent: Any) -> None:
    """For a vector environment of each, with a wrapper, and with plain and asynchronous agents."""
    expected = by_key(list(gem.rollout(COUNTDOWN, agent, episodes=6, seed=5)))
    for episode in expected:
        episode.wrappers = [["latest", {}]]
        episode.info["view"] = "latest"
    with gem.make_vec(COUNTDOWN, 3, backend=backend, wrappers="latest", seed=5) as vector:
        assert run(collected(gem.arollout(vector, agent, episodes=6))) == expected
        assert by_key(list(gem.rollout(vector, agent, episodes=6))) == expected


@pytest.mark.parametrize("kind", ["inline", "async"])
def test_an_id_several_ids_and_an_environment_are_taken(kind: str) -> None:
    """As by ``rollout``; the environment that was given stays open."""
    expected = by_key(list(gem.rollout(KINDS[kind], sampling_agent, episodes=3, seed=2)))
    assert run(collected(gem.arollout(KINDS[kind], sampling_agent, episodes=3, seed=2))) == expected
    with gem.make(KINDS[kind]) as env:
        assert run(collected(gem.arollout(env, sampling_agent, episodes=3, seed=2))) == expected
        env.reset(seed=1)
        env.step("a")
    both = run(collected(gem.arollout([KINDS[kind], "toy:Sums-v0"], answer_a, episodes=2, seed=2)))
    assert [episode.id for episode in both] == [KINDS[kind], "toy:Sums-v0"] * 2


def test_it_works_on_the_loop_of_the_library_itself() -> None:
    """Where asynchronous environments run as well."""

    async def main() -> int:
        return len(await collected(gem.arollout(gem.make_vec(KINDS["async"], 2, seed=0), answer_a, episodes=4)))

    assert asyncio.run_coroutine_threadsafe(main(), background_loop()).result(LONG_S) == 4


# Who waits for whom.


def test_the_loop_goes_on_while_a_worker_is_slow(tmp_path: Path) -> None:
    """Another task of the loop lets the thread go that opens the pipe on which the environment waits."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    opener = threading.Thread(target=pipe.write_text, args=("go",), daemon=True)
    plan = [*lasting(2), PlanItem(kwargs={"pipe": str(pipe)}, options={"left": 1}), *lasting(2)]

    async def main() -> None:
        asked = asyncio.Event()

        async def agent(observation: gem.Observation, context: Context) -> str:
            asked.set()
            return "a"

        vector = gem.make_vec(KINDS["process"], 2, seed=0, backend=("auto", {"workers": 1}))
        with vector, a_busy_loop_lets_go(asked, opener.start):
            assert len(await collected(gem.arollout(vector, agent, plan=plan))) == 3

    run(main())


def test_a_step_that_an_abandoned_run_left_is_not_waited_for() -> None:
    """Another run begins in the same vector environment, with another environment in that slot."""

    async def agent(observation: gem.Observation, context: Context) -> str:
        while context.episode != "0.0" and not BEGUN:
            await asyncio.sleep(0)  # until the step that is held up has begun
        return "a"

    async def main() -> None:
        plan = [PlanItem(kwargs={"gate": "left"}), *lasting(1, 1)]
        with gem.make_vec(KINDS["thread"], 2, seed=0) as vector:
            first = gem.arollout(vector, agent, plan=plan)
            await anext(first)
            await first.aclose()  # type: ignore[attr-defined]  # it is a generator
            assert len(await collected(gem.arollout(vector, answer_a, plan=lasting(1, 1)))) == 2
            GATES["left"].set()

    run(main())


@pytest.mark.parametrize("kind", ["thread", "async"])
def test_a_slow_environment_holds_up_only_its_own_slot(kind: str) -> None:
    """All other episodes are over before its first step is."""

    async def main() -> list[str]:
        plan = [PlanItem(kwargs={"gate": "slow"}), *lasting(*[3] * 8)]
        order: list[str] = []
        async for episode in gem.arollout(gem.make_vec(KINDS[kind], 3, seed=0), answer_a, plan=plan):
            order.append(episode.key)
            if len(order) == 8:
                GATES["slow"].set()
        return order

    order = run(main())
    assert order[-1] == "0"
    assert sorted(order) == list("012345678")


# How many requests.


@pytest.mark.parametrize("most", [1, 3, None])
@pytest.mark.parametrize("on_own_loop", [True, False], ids=["arollout", "rollout"])
def test_requests_at_once_reach_what_is_allowed_and_no_more(most: int | None, on_own_loop: bool) -> None:
    """The first answers wait until there are so many; then each that ends makes room for one."""
    wanted = most or 8
    open_now = peak = asked = 0
    full: asyncio.Event | None = None

    async def agent(observation: gem.Observation, context: Context) -> str:
        nonlocal open_now, peak, asked, full
        full = full or asyncio.Event()
        open_now, asked = open_now + 1, asked + 1
        peak = max(peak, open_now)
        if open_now == wanted:
            full.set()
        await full.wait()
        for _ in range(asked % 5):
            await asyncio.sleep(0)
        open_now -= 1
        return "a"

    vector, plan = gem.make_vec(COUNTDOWN, 8, seed=0), lasting(*[3] * 24)
    if on_own_loop:
        assert len(run(collected(gem.arollout(vector, agent, plan=plan, max_requests=most)))) == 24
    else:
        assert len(list(gem.rollout(vector, agent, plan=plan, max_requests=most))) == 24
    assert (peak, asked, open_now) == (wanted, 72, 0)


def test_slots_take_turns_though_the_agent_never_waits() -> None:
    """Who waited first is asked first, where one request is open at a time."""
    asked: list[str] = []

    async def agent(observation: gem.Observation, context: Context) -> str:
        asked.append(context.episode)
        return "a"

    run(collected(gem.arollout(gem.make_vec(COUNTDOWN, 3, seed=0), agent, plan=lasting(3, 3, 3), max_requests=1)))
    assert asked == ["0.0", "1.0", "2.0"] * 3


@pytest.mark.parametrize("most", [0, True])
def test_a_number_of_requests_that_cannot_be_is_refused(most: Any) -> None:
    """Before anything is made."""
    with pytest.raises(ArgumentError, match=f"max_requests.*{most}"):
        gem.arollout(COUNTDOWN, answer_a, max_requests=most)


# Ends before the end.


class Waiting:
    """An agent whose first episode goes on at once, while the requests of all others stay open until cancelled."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.ended: list[str] = []

    async def __call__(self, observation: gem.Observation, context: Context) -> str:
        if context.episode == "0.0":
            return "a"
        self.begun.append(context.episode)
        try:
            await asyncio.Event().wait()
        finally:
            self.ended.append(context.episode)
        return "never"


@pytest.mark.parametrize("by_break", [True, False], ids=["break", "aclose"])
def test_leaving_cancels_every_request_and_closes_what_was_made(
    by_break: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those too that have not begun; no task is left on the loop."""
    closed: list[str] = []
    close = gem.VectorEnv.close
    monkeypatch.setattr(gem.VectorEnv, "close", lambda self: (closed.append("closed"), close(self))[1])
    agent = Waiting()

    async def main() -> None:
        there = asyncio.all_tasks()

        def left() -> set[asyncio.Task[Any]]:
            return asyncio.all_tasks() - there

        episodes = gem.arollout([COUNTDOWN] * 4, agent, plan=lasting(*[2] * 8), seed=0)
        async for _ in episodes:
            break
        if by_break:
            holder: dict[str, Any] = {"episodes": episodes}
            holder["itself"] = holder
            del episodes, holder, _
            gc.collect()
            while not closed or left():
                await asyncio.sleep(0)
        else:
            await episodes.aclose()  # type: ignore[attr-defined]  # it is a generator
        assert left() == set()

    run(main())
    assert closed == ["closed"]
    assert sorted(agent.ended) == sorted(agent.begun)


def test_cancelling_the_task_that_takes_the_episodes_ends_the_run() -> None:
    """The requests are cancelled before it is over."""
    agent = Waiting()

    async def main() -> None:
        plan = lasting(1, 1, 1)
        took = asyncio.create_task(collected(gem.arollout(gem.make_vec(COUNTDOWN, 3, seed=0), agent, plan=plan)))
        while len(agent.begun) < 2:
            await asyncio.sleep(0)
        took.cancel()
        with pytest.raises(asyncio.CancelledError):
            await took
        assert sorted(agent.ended) == ["1.0", "2.0"]

    run(main())


def test_error_of_the_agent_ends_the_run_and_every_other_request() -> None:
    """Also where several fail at once: one is raised, and asyncio has nothing to complain of."""
    ended: list[str] = []

    async def agent(observation: gem.Observation, context: Context) -> str:
        try:
            await asyncio.sleep(0)
            if context.episode in ("0.0", "1.0"):
                raise ValueError(f"no answer in {context.episode}")
            await asyncio.Event().wait()
        finally:
            ended.append(context.episode)
        return "never"

    with pytest.raises(ValueError, match=r"no answer in 0\.0"):
        run(collected(gem.arollout(gem.make_vec(COUNTDOWN, 4, seed=0), agent, episodes=4)))
    assert sorted(ended) == ["0.0", "1.0", "2.0", "3.0"]


def test_what_is_over_comes_out_before_the_error_that_ends_the_run() -> None:
    """Both are found in the same turn of the loop, and nothing that was finished is lost."""

    def agent(observation: gem.Observation, context: Context) -> str:
        if context.episode == "0.0":
            raise RequestError("the server is down")
        raise EnvFaultError("nothing can be sampled")

    async def main() -> None:
        episodes = gem.arollout(gem.make_vec(COUNTDOWN, 2, seed=0, on_error="raise"), agent, episodes=2)
        assert (await anext(episodes)).key == "0"
        with pytest.raises(EnvFaultError, match="nothing can be sampled"):
            await anext(episodes)

    run(main())


# Agents.


def test_awaitables_of_any_kind_are_answers() -> None:
    """A plain function may return a future, or an object that can be awaited."""

    class Later:
        def __await__(self) -> Any:
            yield from asyncio.sleep(0).__await__()
            return "a"

    def agent(observation: gem.Observation, context: Context) -> Awaitable[str]:
        if context.turn == 0:
            return Later()
        future: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        future.set_result("b")
        return future

    episodes = run(collected(gem.arollout(COUNTDOWN, agent, plan=lasting(2, 2), seed=0)))
    assert [[turn.action for turn in episode.transitions] for episode in episodes] == [["a", "b"]] * 2


def test_endless_plans_are_drawn_from_as_slots_need_them() -> None:
    """No item ahead of the slots."""
    drawn = 0

    def endless() -> Any:
        nonlocal drawn
        while True:
            drawn += 1
            yield PlanItem(options={"left": 1})

    async def main() -> None:
        episodes = gem.arollout(gem.make_vec(COUNTDOWN, 3, seed=0), answer_a, plan=endless())
        taken = 0
        async for _ in episodes:
            taken += 1
            assert drawn <= taken + 2 * 3
            if taken == 20:
                break
        await episodes.aclose()  # type: ignore[attr-defined]  # it is a generator

    run(main())
