"""Environments of vector environments that raise, hang, die or return rubbish, in every backend that contains it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import vector_envs
from vector_envs import ASYNC, INLINE, MISSING, PROCESS, THREAD

import gem_core as gem
from gem_core.errors import ArgumentError, EntryPointError, EnvFaultError, FaultBudgetError, ResetNeededError
from gem_core.records.plans import PlanItem
from gem_core.vector import slot

HOMES = [(INLINE, "sync"), (THREAD, "async"), (ASYNC, "async"), (PROCESS, "auto")]
"""Kinds of environments, and where they live."""

TIMED = [(THREAD, "process"), (THREAD, "async"), (ASYNC, "async"), (INLINE, "auto")]

SHORT_S = 1.0
"""A ``step_timeout``: nothing but what hangs takes so long, also on a machine that is busy."""


@pytest.fixture(autouse=True)
def nothing_left_hanging() -> Iterator[None]:
    """Threads that hang end with the test."""
    yield
    vector_envs.HUNG.set()
    vector_envs.HUNG.clear()


def stepped(env_id: str, backend: Any, word: str, **options: Any) -> tuple[dict[str, Any], gem.VectorEnv]:
    """Let slot 0 misbehave beside slot 1; return the error, after a look at what else came of it."""
    vector = gem.make_vec(env_id, 2, backend=backend, seed=1, length=3, **options)
    vector.reset()
    step = vector.step([f"a!{word}", "b"])
    beside = step.observations[1]
    expected = gem.make_vec(INLINE, 2, backend="sync", seed=1, length=3)
    expected.reset()
    assert beside == expected.step({1: "b"}).observations[0]
    assert (step.truncated[0], step.terminated.any()) == (True, False)
    assert step.rewards[0] == 0.0
    assert step.infos[0]["final_obs"] == gem.TERMINAL_STATE
    assert vector.faults == 1
    # Both go on.
    assert vector.step(["c", "d"]).infos[0]["path"] == ["c"]
    error: dict[str, Any] = step.infos[0]["final_info"]["error"]
    return error, vector


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("raise", "step raised RuntimeError: broken on purpose"),
        ("mute", "step raised MuteError, which cannot be shown"),
        ("panic", "step raised PanicError: at the disco"),
        ("quit", "step raised SystemExit: 3"),
        ("cancel", "step raised CancelledError()"),
        ("leave", "step raised GeneratorExit()"),
        ("recurse", "step raised RecursionError: maximum recursion depth exceeded"),
        ("nothing", "step raised TypeError: {name}: step must return"),
        ("no reward", "step raised ValueError: {name}: the reward must be a finite number, not 'much'"),
        ("nan", "step raised ValueError: {name}: the reward must be a finite number, not nan"),
    ],
)
@pytest.mark.parametrize(("env_id", "backend"), [(INLINE, "sync"), (THREAD, "async"), (ASYNC, "async")])
def test_whatever_a_step_raises_or_returns_ends_its_own_episode_only(
    env_id: str, backend: str, word: str, message: str
) -> None:
    """Also what is no ``Exception``, and what cannot be shown."""
    error, vector = stepped(env_id, backend, word)
    vector.close()
    assert error["kind"] == "exception"
    name = {INLINE: "WalkEnv", THREAD: "ThreadWalkEnv", ASYNC: "AsyncWalkEnv"}[env_id]
    assert error["message"].startswith(message.format(name=name))


def test_whatever_a_step_raises_or_returns_is_contained_in_a_worker_too() -> None:
    """One worker goes on through it all."""
    vector = gem.make_vec([INLINE, THREAD, ASYNC], 3, backend=("process", {"workers": 1}), seed=1, length=1)
    vector.reset()
    first = vector.step(["!pid"] * 3).infos[0]["final_info"]["pid"]
    words = ["raise", "mute", "panic", "quit", "cancel", "leave", "recurse", "nothing", "nan", "unpicklable", "one way"]
    for word in words:
        infos = vector.step([f"a!{word}"] * 3).infos
        assert [info["final_info"]["error"]["kind"] for info in infos] == ["exception"] * 3, word
        vector.step(["a"] * 3)  # episodes that end by themselves, since faults in a row stop a run
    assert infos[0]["final_info"]["error"]["message"] == (
        "its result cannot be read in another process: TypeError: no way back"
    )
    assert {info["final_info"]["pid"] for info in vector.step(["!pid"] * 3).infos} == {first}
    assert vector.faults == 3 * len(words)
    vector.close()


@pytest.mark.parametrize(("env_id", "backend"), [(THREAD, "async"), (ASYNC, "async")])
def test_interrupt_that_an_environment_raises_in_a_thread_is_its_own_fault(env_id: str, backend: str) -> None:
    """The user's comes to the main thread alone."""
    error, vector = stepped(env_id, backend, "interrupt")
    vector.close()
    assert error["message"] == "step raised KeyboardInterrupt()"


def test_interrupt_of_the_user_is_not_contained() -> None:
    """Ctrl-C in a step that runs in the main thread."""
    vector = gem.make_vec(INLINE, 2, backend="sync", seed=1, length=3)
    vector.reset()
    with pytest.raises(KeyboardInterrupt):
        vector.step(["a!interrupt", "b"])
    assert vector.closed


@pytest.mark.parametrize(("env_id", "backend"), HOMES)
@pytest.mark.parametrize(
    "item",
    [PlanItem(kwargs={"init": "raise"}), PlanItem(options={"fault": "raise"}), PlanItem(options={"fault": "short"})],
)
def test_fault_in_making_or_reset_uses_its_item_up(env_id: str, backend: str, item: PlanItem) -> None:
    """The others begin as planned."""
    vector = gem.make_vec(env_id, 2, backend=backend, seed=1, plan=[PlanItem(), item, PlanItem(), PlanItem()])
    observations, infos = vector.reset()
    assert [entry["key"] for entry in infos[1]["failed_resets"]] == ["1"]
    assert infos[1]["failed_resets"][0]["error"]["kind"] == "exception"
    alone = gem.make_vec(INLINE, 3, backend="sync", seed=1, plan=[PlanItem()] * 3).reset()[0]
    assert observations == [alone[0], alone[2]]
    vector.close()


@pytest.mark.parametrize(
    ("env_id", "backend"), [(INLINE, "sync"), (THREAD, "async"), (ASYNC, "async"), (INLINE, "process")]
)
def test_fault_in_close_loses_nothing(env_id: str, backend: str, caplog: pytest.LogCaptureFixture) -> None:
    """A warning says so where this process closes it."""
    plan = [PlanItem(kwargs={"on_close": "raise"}, options={"length": 1}), PlanItem(options={"length": 1})]
    vector = gem.make_vec(env_id, 1, backend=backend, seed=1, plan=plan)
    vector.reset()
    with caplog.at_level(logging.WARNING):
        assert vector.step(["a"]).infos[0]["final_info"]["path"] == ["a"]
        assert vector.step(["b"]).infos[0]["final_info"]["path"] == ["b"]
        vector.close()
    assert vector.faults == 0
    assert backend == "process" or "closing an environment failed" in caplog.text


# What hangs.


@pytest.mark.few(2)
@pytest.mark.parametrize(("env_id", "backend"), TIMED)
def test_hanging_step_is_given_up(env_id: str, backend: str) -> None:
    """After ``step_timeout`` seconds its slot is truncated; a deterministic neighbour goes on."""
    error, vector = stepped(env_id, backend, "hang", step_timeout=SHORT_S)
    vector.close()
    assert error == {"kind": "timeout", "message": "a step or reset took longer than step_timeout, 1 s"}


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("env_id", "backend", "item"),
    [
        (THREAD, "async", PlanItem(kwargs={"init": "hang"})),
        (ASYNC, "async", PlanItem(options={"fault": "hang"})),
        (THREAD, "process", PlanItem(options={"fault": "hang"})),
    ],
)
def test_hanging_reset_is_given_up(env_id: str, backend: str, item: PlanItem) -> None:
    """Also where the environment is made."""
    plan = [PlanItem(), item, PlanItem(), PlanItem()]
    vector = gem.make_vec(env_id, 2, backend=backend, seed=1, plan=plan, step_timeout=SHORT_S)
    _, infos = vector.reset()
    failed = [entry for info in infos for entry in info.get("failed_resets", ())]
    assert [(entry["key"], entry["error"]["kind"]) for entry in failed] == [("1", "timeout")]
    vector.close()


def test_step_timeout_that_nothing_could_keep_is_refused() -> None:
    """By ``sync``, and by ``async`` for what runs in place; ``auto`` moves that to workers."""
    with pytest.raises(ArgumentError, match=r"step_timeout.*'sync'"):
        gem.make_vec(THREAD, 2, backend="sync", step_timeout=1)
    with pytest.raises(ArgumentError, match=f"step_timeout.*'{INLINE}'"):
        gem.make_vec([THREAD, INLINE], 2, backend="async", step_timeout=1)
    with gem.make_vec([INLINE, THREAD], 2, backend="auto", step_timeout=60, seed=1, length=2) as vector:
        vector.reset()
        pids = [info["pid"] for info in vector.step(["!pid"] * 2).infos]
        assert pids[0] != vector_envs.os.getpid() == pids[1]
    for wrong in (0, float("inf"), float("nan"), "1"):
        with pytest.raises(ArgumentError, match="step_timeout must be a positive number of seconds"):
            gem.make_vec(THREAD, backend="async", step_timeout=wrong)  # type: ignore[arg-type]  # that is the point


def test_abandoned_threads_close_what_they_held() -> None:
    """Once they come back, whether or not the vector environment is there."""
    vector = gem.make_vec(THREAD, 3, backend="async", seed=1, length=3, on_close="count", step_timeout=SHORT_S)
    vector.reset()
    vector.step({0: "!hang", 1: "!hang", 2: "a"})
    vector.close()
    # Those that replaced the hanging ones, and that of slot 2.
    assert [vector_envs.CLOSED.acquire(timeout=60) for _ in range(3)] == [True] * 3
    assert not vector_envs.CLOSED.acquire(blocking=False)
    vector_envs.HUNG.set()
    assert [vector_envs.CLOSED.acquire(timeout=60) for _ in range(2)] == [True] * 2


def test_too_many_abandoned_threads_stop_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """They cannot be ended, so there is a most of them."""
    monkeypatch.setattr(slot, "MOST_ABANDONED", 2)
    vector = gem.make_vec(THREAD, 3, backend="async", seed=1, length=3, step_timeout=SHORT_S)
    vector.reset()
    with pytest.raises(FaultBudgetError, match="3 environments hang in threads that cannot be ended"):
        vector.step(["!hang"] * 3)
    vector.close()


def test_abandoned_task_is_cancelled() -> None:
    """No thread hangs in its stead."""
    vector_envs.CANCELLED.clear()
    vector = gem.make_vec(ASYNC, 2, backend="async", seed=1, length=3, step_timeout=SHORT_S)
    vector.reset()
    assert vector.step(["a!hang", "b"]).truncated.tolist() == [True, False]
    assert vector_envs.CANCELLED.wait(60)
    vector.close()


# Death.


@pytest.mark.parametrize(
    ("env_id", "backend", "word", "told"), [(THREAD, "process", "exit", "7"), (PROCESS, "auto", "segv", "SIGSEGV")]
)
def test_death_of_a_worker_ends_the_episode_that_did_it(env_id: str, backend: str, word: str, told: str) -> None:
    """What lives in another worker goes on as if nothing had happened."""
    error, vector = stepped(env_id, (backend, {"workers": 2}), word)
    vector.close()
    assert error["kind"] == "died"
    assert told in error["message"]


@pytest.mark.few(1)
@pytest.mark.parametrize("item", [PlanItem(kwargs={"init": "exit"}), PlanItem(options={"fault": "exit"})])
def test_death_in_a_reset_is_that_of_its_own_item(item: PlanItem) -> None:
    """Those that began before it, and wait behind it, are not blamed."""
    plan = [PlanItem(), PlanItem(), item, *[PlanItem()] * 3]
    vector = gem.make_vec(INLINE, 5, backend=("process", {"workers": 1}), seed=1, plan=plan)
    observations, infos = vector.reset()
    failed = [entry for info in infos for entry in info.get("failed_resets", ())]
    assert [(entry["key"], entry["error"]["kind"]) for entry in failed] == [("2", "died")]
    assert vector.faults == 1
    vector.close()
    alone = gem.make_vec(INLINE, 6, backend="sync", seed=1, plan=[PlanItem()] * 6).reset()[0]
    assert sorted(map(str, observations)) == sorted(str(alone[key]) for key in (0, 1, 3, 4, 5))


def test_neighbours_of_a_death_end_as_collateral() -> None:
    """They are marked, and do not count as faults; then all go on in another worker."""
    vector = gem.make_vec(INLINE, 3, backend=("process", {"workers": 1}), seed=1, length=9)
    vector.reset()
    vector.step(["a"] * 3)
    died = vector.step({1: "b!exit"})
    beside = vector.step({0: "b", 2: "b"})
    kinds = [info["final_info"]["error"]["kind"] for info in (*died.infos, *beside.infos)]
    assert kinds == ["died", "collateral", "collateral"]
    assert vector.faults == 1
    assert [info["path"] for info in vector.step(["c"] * 3).infos] == [["c"]] * 3
    vector.close()


# Endless failures.


@pytest.mark.parametrize(("env_id", "backend"), HOMES)
def test_endless_failures_stop_with_one_error(env_id: str, backend: str) -> None:
    """In ``reset``, whatever the plan has left."""
    vector = gem.make_vec(env_id, 2, backend=backend, seed=1, init="quit")
    with pytest.raises(FaultBudgetError, match=r"^1[78] faults"):
        vector.reset()
    vector.close()


@pytest.mark.parametrize("backend", ["sync", "async", "process", "auto"])
def test_entry_point_that_cannot_be_imported_is_one_clear_error(backend: str) -> None:
    """Every backend says the same, also for an id that only the plan names."""
    for options in ({"ids": MISSING}, {"ids": INLINE, "plan": [PlanItem(id=MISSING), PlanItem()]}):
        with pytest.raises(EntryPointError, match="there is no module 'vector_envs_that_are_not_there'"):
            begun(backend, **options)


def begun(backend: str, **options: Any) -> None:
    with gem.make_vec(num_envs=2, backend=backend, **options) as vector:
        vector.reset()


@pytest.mark.parametrize(("env_id", "backend"), HOMES)
def test_on_error_raise_raises_in_every_backend(env_id: str, backend: str) -> None:
    """What failed in a worker comes with its traceback as a note."""
    vector = gem.make_vec(env_id, 2, backend=backend, seed=1, length=3, on_error="raise")
    vector.reset()
    with pytest.raises(EnvFaultError, match="step raised RuntimeError: broken on purpose") as caught:
        vector.step(["a!raise", "b"])
    away = env_id == PROCESS
    assert ("broken on purpose" in "".join(getattr(caught.value, "__notes__", []))) == away
    assert (caught.value.__cause__ is None) == away
    with pytest.raises(ResetNeededError, match="slot 0 has no environment since an error was raised"):
        vector.step(["a", "b"])
    assert vector.step({1: "c"}).infos[0]["path"] == ["b", "c"]
    vector.reset()
    vector.close()


def test_other_slots_can_be_reset_beside_one_that_an_error_left_empty() -> None:
    """What the empty one observed last is not to be had."""
    vector = gem.make_vec(INLINE, 2, backend="sync", seed=1, length=3, on_error="raise", autoreset="disabled")
    vector.reset()
    with pytest.raises(EnvFaultError):
        vector.step(["a!raise", "b"])
    observations, infos = vector.reset(options={"reset_mask": [False, True]})
    assert observations[0] == ""
    assert (infos[0], infos[1]["turn"]) == ({}, 0)


# What cannot travel.


def test_arguments_of_a_plan_travel_as_they_are() -> None:
    """Functions too."""
    plan = [PlanItem(kwargs={"mark": lambda: 3}), PlanItem(kwargs={"mark": {1, 2}})]
    with gem.make_vec(INLINE, 2, backend="process", seed=1, plan=plan) as vector:
        assert vector.reset()[1][0]["turn"] == 0


@pytest.mark.parametrize(
    "item", [PlanItem(kwargs={"mark": threading.Lock()}), PlanItem(options={"x": threading.Lock()})]
)
def test_arguments_of_a_plan_that_cannot_travel_are_refused(item: PlanItem) -> None:
    """At once, since the next item would be no better."""
    with pytest.raises(ArgumentError, match=r"_thread\.lock"):
        begun("process", ids=INLINE, plan=[item])


def test_arguments_of_all_environments_that_cannot_travel_are_refused() -> None:
    """The message says what to give instead."""
    with pytest.raises(ArgumentError, match=r"_thread\.lock.*package\.module:Class"):
        gem.make_vec(INLINE, 2, backend="process", mark=threading.Lock())


def test_action_that_cannot_travel_is_a_fault_of_its_slot() -> None:
    """A ``Response`` may hold anything."""
    action = gem.Response("a")
    action.extra = threading.Lock()  # type: ignore[attr-defined]  # that is the point
    with gem.make_vec(INLINE, 2, backend="process", seed=1, length=3) as vector:
        vector.reset()
        step = vector.step([action, "b"])
        assert "cannot be sent to another process" in step.infos[0]["final_info"]["error"]["message"]
        assert step.infos[1]["path"] == ["b"]
