"""Autoreset as in Gymnasium, partial batches, and waiting: plainly, in coroutines, and inside a loop that runs."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import vector_envs
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from vector_envs import ASYNC, INLINE, KINDS, PROCESS, THREAD, Turns

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, BridgeError, ClosedError, ResetNeededError
from gem_core.records.plans import PlanItem

BACKENDS = ["sync", "async", "process", "auto"]
MODES = ["same_step", "next_step", "disabled"]


@pytest.fixture(autouse=True)
def nothing_left_hanging() -> Iterator[None]:
    """Threads that hang, or wait for a turn, end with the test."""
    yield
    vector_envs.HUNG.set()
    vector_envs.HUNG.clear()
    vector_envs.TURNS.clear()


def test_a_wrapper_that_computes_goes_to_workers_with_its_environment() -> None:
    """``auto`` looks at all that is put around a task."""
    for wrappers, here in [([], True), (["concat", vector_envs.Computing], False)]:
        with gem.make_vec(INLINE, 2, wrappers=wrappers, length=2) as vector:
            vector.reset()
            assert {info["pid"] == os.getpid() for info in vector.step(["!pid"] * 2).infos} == {here}


# Autoreset.


class Counter(gymnasium.Env[np.int64, int]):
    """The walk's counterpart for Gymnasium: ends after as many steps as its number says."""

    observation_space = gymnasium.spaces.Discrete(1000)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, length: int) -> None:
        self.length = length

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.turn = 0
        return np.int64(0), {"turn": 0}

    def step(self, action: int) -> Any:
        self.turn += 1
        return np.int64(self.turn), float(self.turn), self.turn >= self.length, False, {"turn": self.turn}


class CountingEnv(gem.Env):
    """Its counterpart here."""

    def __init__(self, length: int) -> None:
        super().__init__()
        self.length = length

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.turn = 0
        return "0", {"turn": 0}

    def step(self, action: str) -> Any:
        self.turn += 1
        return str(self.turn), float(self.turn), self.turn >= self.length, False, {"turn": self.turn}


def alternating(lengths: list[int]) -> list[PlanItem]:
    return [PlanItem(options={"length": length}) for length in lengths]


@pytest.mark.parametrize("mode", MODES)
def test_autoreset_is_that_of_gymnasium(mode: Any, own_registry: Any) -> None:
    """Observations, rewards and flags are the same, and what is kept of the episodes that ended."""
    gem.register("own:Counting-v0", CountingEnv)
    lengths = [1, 3, 2]
    modes = {"same_step": AutoresetMode.SAME_STEP, "next_step": AutoresetMode.NEXT_STEP}
    theirs = SyncVectorEnv(
        [lambda length=length: Counter(length) for length in lengths],  # type: ignore[misc]  # bound early
        autoreset_mode=modes.get(mode, AutoresetMode.DISABLED),
    )
    ids = [("own:Counting-v0", {"length": length}) for length in lengths]
    ours = gem.make_vec(ids, 3, autoreset=mode, seed=1)
    observations, _ = theirs.reset()
    assert ours.reset()[0] == [str(one) for one in observations]
    done = np.zeros(3, bool)
    for _ in range(9):
        if mode == "disabled" and done.any():
            observations, _ = theirs.reset(options={"reset_mask": done})
            assert ours.reset(options={"reset_mask": done})[0] == [str(one) for one in observations]
        expected = theirs.step(np.zeros(3, int))
        found = ours.step(["a"] * 3)
        assert found.observations == [str(one) for one in expected[0]]
        assert found.rewards.tolist() == expected[1].tolist()
        assert found.terminated.tolist() == expected[2].tolist()
        assert found.truncated.tolist() == expected[3].tolist()
        done = found.terminated | found.truncated
        if mode == "same_step" and done.any():
            for slot in np.flatnonzero(done):
                assert found.infos[slot]["final_obs"] == str(expected[4]["final_obs"][slot])
                assert found.infos[slot]["final_info"]["turn"] == expected[4]["final_info"]["turn"][slot]
        else:
            assert all("final_obs" not in info for info in found.infos)
    theirs.close()
    ours.close()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("mode", MODES)
def test_nothing_of_a_finished_episode_is_lost(mode: Any, backend: str) -> None:
    """Each turn of each episode is seen once, until the slots are idle."""
    plan = alternating([1, 3, 2, 2, 1])
    seen: list[tuple[str, int]] = []
    with gem.make_vec(INLINE, 2, backend=backend, autoreset=mode, plan=plan, seed=1) as vector:
        vector.reset()
        for _ in range(12):
            keys = [draw and draw.key for draw in map(vector.start_of, range(2))]
            began = [False, False]
            step = vector.step(["a", "b"])
            ended = (step.terminated | step.truncated).tolist()
            for slot, info in enumerate(step.infos):
                last = info.get("final_info", info)
                began[slot] = mode == "next_step" and last.get("turn") == 0
                if keys[slot] is not None and not began[slot] and not last.get("idle"):
                    seen.append((str(keys[slot]), last["turn"]))
            if mode == "disabled" and any(ended):
                vector.reset(options={"reset_mask": ended})
        assert [vector.start_of(slot) for slot in range(2)] == [None, None]
        assert vector.step(["a", "b"]).infos == [{"idle": True}] * 2
    wanted = [(str(key), turn + 1) for key, item in enumerate(plan) for turn in range(item.options["length"])]  # type: ignore[index]  # set above
    assert sorted(seen) == wanted


@pytest.mark.parametrize("backend", BACKENDS)
def test_faults_end_episodes_in_every_mode(backend: str) -> None:
    """In ``next_step`` and ``disabled`` the error is in the info of the step that failed."""
    with gem.make_vec(INLINE, 1, backend=backend, autoreset="next_step", seed=1, length=3) as vector:
        vector.reset()
        step = vector.step(["a!raise"])
        assert (step.observations, step.rewards.tolist(), step.truncated.tolist()) == (
            [gem.TERMINAL_STATE],
            [0.0],
            [True],
        )
        assert step.infos[0]["error"]["kind"] == "exception"
        assert "final_info" not in step.infos[0]
        again = vector.step(["ignored!raise"])
        assert (again.rewards.tolist(), again.truncated.tolist(), again.infos[0]["turn"]) == ([0.0], [False], 0)
        assert vector.step(["b"]).infos[0]["path"] == ["b"]
    with gem.make_vec(INLINE, 2, backend=backend, autoreset="disabled", seed=1, length=3) as vector:
        vector.reset()
        assert vector.step(["a!raise", "b"]).infos[0]["error"]["kind"] == "exception"
        with pytest.raises(ResetNeededError, match="the episode of slot 0 is over, and autoreset is disabled"):
            vector.step(["a", "b"])
        observations, infos = vector.reset(options={"reset_mask": [True, False]})
        assert (infos[0]["turn"], infos[1]) == (0, {})
        assert observations[1].startswith("1: ")  # type: ignore[union-attr]  # text
        assert vector.step(["c", "d"]).infos[1]["path"] == ["b", "d"]


@pytest.mark.parametrize("mask", [[True], [1, 0], None, [[True, False]]])
def test_masks_that_do_not_fit_are_refused(mask: Any) -> None:
    """One bool for each slot."""
    vector = gem.make_vec(INLINE, 2, backend="sync", autoreset="disabled", seed=1)
    vector.reset()
    with pytest.raises(ArgumentError, match="reset_mask must be 2 bools, one for each slot"):
        vector.reset(options={"reset_mask": mask})


def test_a_seed_and_a_mask_for_some_slots_do_not_go_together() -> None:
    """A seed starts the whole run over."""
    vector = gem.make_vec(INLINE, 2, backend="sync", autoreset="disabled", seed=1)
    start = vector.reset()
    with pytest.raises(ArgumentError, match="a seed starts the whole run over"):
        vector.reset(seed=1, options={"reset_mask": [True, False]})
    assert vector.reset(seed=1, options={"reset_mask": [True, True]}) == start


# send and recv.


def hold(order: list[int]) -> None:
    """Let actions that end in "@gate" finish in an order; a negative number waits for ``release``."""
    vector_envs.TURNS["gate"] = Turns(order)


def release(name: int = -1) -> None:
    """Take a turn that stands for the test itself, once it has come."""
    vector_envs.TURNS["gate"].wait(name)


@pytest.mark.parametrize(("env_id", "backend"), [(THREAD, "async"), (ASYNC, "async"), (THREAD, "auto")])
def test_recv_returns_those_that_are_ready_in_order_of_completion(env_id: str, backend: str) -> None:
    """It waits for so many as it is asked for, and no more."""
    vector = gem.make_vec(env_id, 4, backend=backend, seed=1, length=9)
    vector.reset()
    hold([2, -1, 0, -2, 3, 1])
    vector.send([f"{slot}@gate" for slot in range(4)])
    assert vector.under_way == 4
    first = vector.recv()
    release(-1)
    second = vector.recv()
    assert (first.slots, second.slots) == ([2], [0])
    assert [info["path"] for info in (*first.infos, *second.infos)] == [["2@gate"], ["0@gate"]]
    none = vector.recv(timeout=0.001)
    assert (none.slots, none.observations, none.rewards.shape, none.infos) == ([], [], (0,), [])
    assert vector.recv(min_envs=0).slots == []
    # Those that came back go on, beside those that are under way.
    assert vector.step({0: "x", 2: "y"}).infos[0]["path"] == ["0@gate", "x"]
    for busy in ({3: "z"}, ["z"] * 4):
        with pytest.raises(ArgumentError, match=r"slot [13] is under way; call recv\(\) until it has come back"):
            vector.send(busy)
        with pytest.raises(ArgumentError, match=r"slot [13] is under way; call recv\(\) until it has come back"):
            vector.step(busy)
    with pytest.raises(ArgumentError, match="is under way"):
        vector.reset(options={"reset_mask": [False, True, False, False]})
    release(-2)
    assert sorted(vector.recv(min_envs=99).slots) == [1, 3]
    with pytest.raises(ArgumentError, match="nothing is under way"):
        vector.recv()
    vector.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_idle_slots_come_back_too(backend: str) -> None:
    """They say that they are idle, and a whole batch is received."""
    with gem.make_vec(INLINE, 3, backend=backend, seed=1, plan=alternating([1, 2])) as vector:
        vector.reset()
        for _ in range(3):
            vector.send(["a", "b", "c"])
            received = vector.recv(min_envs=3)
            assert sorted(received.slots) == [0, 1, 2]
        assert received.infos == [{"idle": True}] * 3


@pytest.mark.parametrize("wrong", [-1, 1.5, True])
def test_numbers_of_environments_that_cannot_be_are_refused(wrong: Any) -> None:
    """Before anything is waited for."""
    vector = gem.make_vec(INLINE, 2, backend="sync", seed=1)
    vector.reset()
    vector.send(["a", "b"])
    with pytest.raises(ArgumentError, match="min_envs must be a whole number from 0 up"):
        vector.recv(min_envs=wrong)
    assert vector.recv(2).slots == [0, 1]


def test_what_was_received_is_not_received_again_by_a_step() -> None:
    """``step`` of some slots while others are under way."""
    vector = gem.make_vec(INLINE, 3, backend="process", seed=1, length=9)
    vector.reset()
    vector.send({0: "a", 2: "c"})
    assert vector.step({1: "b"}).infos[0]["path"] == ["b"]
    assert sorted(vector.recv(2).slots) == [0, 2]
    assert [info["path"] for info in vector.step(["x"] * 3).infos] == [["a", "x"], ["b", "x"], ["c", "x"]]
    vector.close()


def test_sent_to_while_another_thread_waits() -> None:
    """Whoever waits already gets it."""
    vector = gem.make_vec([THREAD, INLINE], 2, backend="async", seed=1, length=9)
    vector.reset()
    hold([-1, 0])
    vector.send({0: "0@gate"})
    got: list[list[int]] = []
    waiting = threading.Thread(target=lambda: got.append(vector.recv().slots))
    waiting.start()
    vector.send({1: "b"})
    waiting.join(60)
    assert got == [[1]]
    release()
    assert vector.recv().slots == [0]
    vector.close()


# Coroutines.


@pytest.mark.parametrize("backend", BACKENDS)
def test_coroutines_do_what_plain_calls_do(backend: str) -> None:
    """Inside a loop that runs, beside plain calls in the same loop."""

    async def run() -> list[Any]:
        kept: list[Any] = []
        with gem.make_vec(list(KINDS), 4, backend=backend, seed=1, length=2) as vector:
            kept.append(await vector.reset_async())
            kept.append(list(await vector.step_async(["a"] * 4)))
            kept.append(list(vector.step(["b"] * 4)))  # as in a notebook
            vector.send({0: "c", 3: "d"})
            received = await vector.recv_async(min_envs=2)
            kept.append(sorted(zip(received.slots, received.observations, strict=True)))
            kept.append(list(await vector.step_async({1: "e"})))
            kept.append(vector.reset())
        return kept

    async def elsewhere() -> list[Any]:
        with gem.make_vec(INLINE, 4, backend="sync", seed=1, length=2) as vector:
            kept: list[Any] = [vector.reset(), list(vector.step(["a"] * 4)), list(vector.step(["b"] * 4))]
            some = vector.step({0: "c", 3: "d"})
            kept.append([(0, some.observations[0]), (3, some.observations[1])])
            kept.append(list(vector.step({1: "e"})))
            kept.append(vector.reset())
        return kept

    assert repr(asyncio.run(run())) == repr(asyncio.run(elsewhere()))


@pytest.mark.parametrize("backend", ["async", "process", "auto"])
def test_steps_of_disjoint_slots_run_at_the_same_time(backend: str) -> None:
    """Two coroutines, each with slots of its own; the one that began last finishes first."""

    async def run() -> None:
        vector = gem.make_vec([THREAD, ASYNC, INLINE, PROCESS], 4, backend=backend, seed=1, length=9)
        await vector.reset_async()
        if backend != "process":
            hold([1, 0])
        first = asyncio.create_task(vector.step_async({0: "0@gate", 2: "b"}))
        await asyncio.sleep(0)
        second = await vector.step_async({1: "1@gate", 3: "c"})
        assert [info["path"] for info in second.infos] == [["1@gate"], ["c"]]
        assert [info["path"] for info in (await first).infos] == [["0@gate"], ["b"]]
        vector.close()

    asyncio.run(run())


def test_two_coroutines_may_wait_for_the_same_slots() -> None:
    """Neither is forgotten."""

    async def run() -> None:
        vector = gem.make_vec(THREAD, 2, backend="async", seed=1, length=9)
        await vector.reset_async()
        hold([-1, 0, -2, 1])
        vector.send(["0@gate", "1@gate"])
        waits = [asyncio.create_task(vector.recv_async()) for _ in range(2)]
        await asyncio.sleep(0)
        release()
        done, left = await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        assert [task.result().slots for task in done if task.result().slots] == [[0]]
        release(-2)
        slots = [task.result().slots for task in waits if task in done]
        slots += [(await task).slots for task in left]
        while vector.under_way:
            slots.append((await vector.recv_async()).slots)
        assert sorted(slot for some in slots for slot in some) == [0, 1]
        vector.close()

    asyncio.run(run())


def test_a_step_that_is_cancelled_closes_the_vector_environment() -> None:
    """As Ctrl-C does in plain code."""

    async def run() -> None:
        vector = gem.make_vec(THREAD, 2, backend="async", seed=1, length=9)
        await vector.reset_async()
        hold([-1, 0])
        task = asyncio.create_task(vector.step_async({0: "0@gate"}))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        release()
        with pytest.raises(ClosedError):
            await vector.step_async({1: "b"})

    asyncio.run(run())


def test_closing_ends_a_step_that_waits() -> None:
    """In another task; it is told what happened."""

    async def run() -> None:
        vector = gem.make_vec(THREAD, 2, backend="async", seed=1, length=9)
        await vector.reset_async()
        hold([-1, 0])
        task = asyncio.create_task(vector.step_async({0: "0@gate"}))
        await asyncio.sleep(0)
        vector.close()
        release()
        with pytest.raises(ClosedError):
            await task

    asyncio.run(run())


@pytest.mark.parametrize("env_id", [THREAD, ASYNC, PROCESS])
def test_waiting_on_the_librarys_own_loop_is_an_error(env_id: str) -> None:
    """It would wait for itself; coroutines work there."""
    vector = gem.make_vec(env_id, 2, seed=1, length=9)

    async def plainly() -> None:
        vector.reset()

    async def rightly() -> Any:
        await vector.reset_async()
        return await vector.step_async(["a", "b"])

    with pytest.raises(BridgeError, match="step_async"):
        run_sync(plainly())
    assert [info["turn"] for info in run_sync(rightly()).infos] == [1, 1]
    vector.close()


def test_what_runs_in_place_may_be_stepped_on_the_librarys_own_loop() -> None:
    """There is nothing to wait for."""
    vector = gem.make_vec(INLINE, 2, seed=1, length=9)

    async def plainly() -> Any:
        vector.reset()
        return vector.step(["a", "b"])

    assert [info["turn"] for info in run_sync(plainly()).infos] == [1, 1]
    vector.close()
