"""Faults injected at random in all backends, with a checker that every episode is accounted for exactly once."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest
import vector_envs
from vector_envs import ASYNC, INLINE, KINDS, PROCESS, THREAD, eventually, is_alive

import gem_core as gem
from gem_core.background import background_loop
from gem_core.records.plans import PlanItem
from gem_core.rollouts.agent import Context
from gem_core.vector.slot import FaultBudget

MILD = ["raise", "mute", "panic", "quit", "cancel", "recurse", "nothing", "no reward", "nan", "reported", "unpicklable"]
DEADLY = ["exit", "kill", "one way", "children", "memory"]
KINDS_OF_ERRORS = {"exception", "timeout", "died", "collateral", "engine", "agent"}


class Home(NamedTuple):
    """Where environments live in a round.

    Args:
        backend: Name and options.
        ids: Environments.
        words: What they may be told to do.
        deadly: Ids that live in workers, and may be told to end them.
        timeout: A ``step_timeout``, with which they may be told to hang.
    """

    backend: Any
    ids: list[str]
    words: list[str] = MILD
    deadly: frozenset[str] = frozenset()
    timeout: float | None = None


HOMES = {
    "sync": Home("sync", [INLINE]),
    "async": Home("async", [INLINE, THREAD, ASYNC]),
    "async with a time limit": Home("async", [THREAD, ASYNC], timeout=0.5),
    "process": Home(("process", {"workers": 2}), [*KINDS], deadly=frozenset(KINDS), timeout=0.5),
    "process in place": Home(("process", {"workers": 2}), [INLINE, PROCESS], deadly=frozenset([INLINE, PROCESS])),
    "auto": Home(("auto", {"workers": 2}), [*KINDS], deadly=frozenset([INLINE, PROCESS]), timeout=0.5),
}


class Round:
    """One run with faults.

    Args:
        seed: Of everything that is drawn.
        home: Where environments live.
        items: Number of items of the plan.
    """

    def __init__(self, seed: int, home: Home, items: int) -> None:
        self.home = home
        self.random = random.Random(seed)
        self.plan = [self.item() for _ in range(items)]
        self.expected = Counter((str(key), n) for key, item in enumerate(self.plan) for n in range(item.repeat))
        options: dict[str, Any] = {} if home.timeout is None else {"step_timeout": home.timeout}
        self.vector = gem.make_vec(
            home.ids, self.random.choice([1, 3, 7]), backend=home.backend, plan=self.plan, seed=seed, **options
        )
        self.pids: set[int] = set()
        self.over = threading.Event()

    def word(self, env_id: str) -> str:
        words = [*self.home.words, *(DEADLY if env_id in self.home.deadly else ())]
        if self.home.timeout is not None and self.random.random() < 0.15:
            return "hang"
        word = self.random.choice(words)
        return "raise" if word == "memory" and not self.home.deadly else word

    def item(self) -> PlanItem:
        env_id = self.random.choice(self.home.ids)
        options: dict[str, Any] | None = None
        kwargs = {}
        chance = self.random.random()
        if chance < 0.06:
            options = {"fault": self.word(env_id)}
        elif chance < 0.12 and env_id != ASYNC:
            kwargs = {"init": self.word(env_id)}
        elif chance < 0.5:
            options = {"length": self.random.randint(1, 6)}
        return PlanItem(id=env_id, options=options, kwargs=kwargs, repeat=self.random.choice([1, 1, 1, 3]))

    def action(self, env_id: str, sample: Callable[[], str]) -> str:
        chance = self.random.random()
        if chance < 0.12:
            return f"go!{self.word(env_id)}"
        if chance < 0.4:
            return sample()
        return f"go {self.random.randint(0, 99)}"

    # The agents.

    def plain(self, observation: Any, context: Context) -> str:
        return self.action(context.env_id, context.sample_random_action)

    async def later(self, observation: Any, context: Context) -> str:
        await asyncio.sleep(self.random.choice([0, 0, 0.001, 0.005]))
        if self.random.random() < 0.02:
            raise gem.errors.RequestError("the model server is down")
        return self.action(context.env_id, context.sample_random_action)

    # The drivers.

    def rollout(self) -> Iterator[gem.Episode]:
        yield from gem.rollout(self.vector, self.plain)

    def rollout_async(self) -> Iterator[gem.Episode]:
        yield from gem.rollout(self.vector, self.later, max_requests=self.random.choice([None, 2]))

    def arollout(self) -> Iterator[gem.Episode]:
        async def collected() -> list[gem.Episode]:
            return [episode async for episode in gem.arollout(self.vector, self.later)]

        yield from asyncio.run(collected())

    # The saboteur and the checker.

    def sabotage(self) -> None:
        chance = random.Random(self.random.random())
        while not self.over.wait(chance.choice([0.02, 0.2, 0.5, 1.0])):
            pids = vector_envs.workers_of(os.getpid())
            self.pids |= set(pids)
            if pids and chance.random() < 0.3:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(chance.choice(pids), signal.SIGKILL)

    def run(self, driver: str) -> None:
        saboteur = threading.Thread(target=self.sabotage, name="saboteur")
        saboteur.start()
        came: Counter[tuple[str, int]] = Counter()
        try:
            for episode in getattr(self, driver)():
                came[episode.key, episode.repeat] += 1
                self.check(episode)
        finally:
            self.over.set()
            saboteur.join()
            self.vector.close()
            vector_envs.HUNG.set()
            vector_envs.HUNG.clear()
        assert came == self.expected

    def check(self, episode: gem.Episode) -> None:
        """Replay an episode alone."""
        error = episode.error
        whole = list(episode.transitions)
        if error is not None:
            assert isinstance(error, dict)
            assert error["kind"] in KINDS_OF_ERRORS, error
            if not whole:
                return
            del whole[-1]
        env = gem.make(INLINE)
        options = dict(episode.options) if episode.options else None
        observation, info = env.reset(seed=episode.seed, options=options)
        assert (episode.observation, info.items() <= episode.info.items()) == (observation, True)
        for turn in whole:
            assert turn.observation == observation
            observation, reward, terminated, truncated, info = env.step(str(turn.action))
            assert (turn.reward, turn.terminated, turn.truncated) == (reward, terminated, truncated)
            assert {**turn.info, "extra": None} == {**info, "extra": None}
        if error is None:
            assert episode.final_observation == observation
            assert whole[-1].terminated or whole[-1].truncated


def threads() -> list[str]:
    kept = ("gem-loop", "gem-blocking")  # what waits in a thread of its own ends with what it waits for
    return sorted(one.name for one in threading.enumerate() if one.name.startswith("gem-") and one.name not in kept)


@pytest.mark.few(1)
@pytest.mark.parametrize("driver", ["rollout", "rollout_async", "arollout"])
@pytest.mark.parametrize("home", HOMES)
def test_every_episode_is_accounted_for_exactly_once(home: str, driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is right to the letter, or marked with an error; and nothing is left behind."""
    monkeypatch.setattr(FaultBudget, "note", lambda *args: None)  # it is the accounting that is looked at here
    with gem.make_vec(THREAD, backend="process", seed=0) as warm:
        warm.reset()
    background_loop()
    eventually(lambda: not threads())
    files = len(os.listdir("/proc/self/fd"))
    attempt = Round(1, HOMES[home], items=16)
    attempt.run(driver)
    pids = attempt.pids
    del attempt
    assert eventually(lambda: not threads()), threads()
    assert eventually(lambda: not any(map(is_alive, pids)))
    assert eventually(lambda: len(os.listdir("/proc/self/fd")) <= files)
