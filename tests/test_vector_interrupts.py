"""Ctrl-C at any line of a vector environment leaves it usable."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from vector_envs import ASYNC, INLINE, THREAD

import gem_core as gem
from gem_core.records.plans import PlanItem
from gem_core.vector.vector_env import VectorEnv

FOLDER = str(Path(gem.__file__).parent / "vector")


class InterruptAt:
    """Raises a ``KeyboardInterrupt`` at a line of the vector environment's own code, counted from 0."""

    def __init__(self, line: int) -> None:
        self.left = line
        self.place = ""

    def __call__(self, frame: FrameType, event: str, argument: object) -> Any:
        """Trace what is called; see ``sys.settrace``."""
        if not frame.f_code.co_filename.startswith(FOLDER):
            return None
        if event == "line":
            self.left -= 1
            if self.left < 0:
                sys.settrace(None)
                self.place = f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"
                raise KeyboardInterrupt
        return self


def interrupted(vector: VectorEnv, work: Callable[[VectorEnv], object], line: int) -> str:
    """Interrupt some work at a line; return the place, or nothing where the work was over before."""
    trace, before = InterruptAt(line), sys.gettrace()
    sys.settrace(trace)
    try:
        work(vector)
    except KeyboardInterrupt:
        return trace.place
    finally:
        sys.settrace(before)
    return ""


def calls(vector: VectorEnv) -> None:
    """Wait for all, then for nobody, over the end of an episode; then begin anew."""
    vector.step(["a"] * 3)
    vector.send(["b"] * 3)
    vector.recv(min_envs=3)
    vector.step({0: "c", 2: "c"})
    vector.reset()
    vector.sample_random_action(0)


def episodes(vector: VectorEnv) -> None:
    """Let an agent act."""
    assert len(list(gem.rollout(vector, lambda observation: "a", episodes=4))) == 4


@pytest.mark.few(3)
@pytest.mark.parametrize("work", [calls, episodes])
@pytest.mark.parametrize(
    ("env_id", "backend", "stride"), [(INLINE, "sync", 7), (THREAD, "async", 31), (ASYNC, "async", 31)]
)
def test_interrupt_at_any_line_leaves_it_usable(
    env_id: str, backend: str, stride: int, work: Callable[[VectorEnv], object]
) -> None:
    """The same run begins anew, and gives what it gave."""
    line, expected = 0, None
    while True:
        vector = gem.make_vec(env_id, 3, backend=backend, seed=1, length=2)
        vector.reset()
        place = interrupted(vector, work, line)
        again = vector.reset(seed=1), vector.step(["x"] * 3).observations
        expected = expected or again
        assert again == expected, place
        vector.close()
        if not place:
            return
        line += stride


@pytest.mark.thorough
@pytest.mark.parametrize("work", [calls, episodes])
@pytest.mark.parametrize(
    ("env_id", "backend", "stride"),
    [(INLINE, "sync", 1), (THREAD, "async", 1), (ASYNC, "async", 1), (INLINE, "process", 97)],
)
def test_interrupt_at_every_line_leaves_it_usable(
    env_id: str, backend: str, stride: int, work: Callable[[VectorEnv], object]
) -> None:
    """Also with worker processes, which are replaced."""
    test_interrupt_at_any_line_leaves_it_usable(env_id, backend, stride, work)


def test_interrupt_while_a_step_is_waited_for_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes of it comes by ``recv``."""
    vector = gem.make_vec(THREAD, 3, backend="async", seed=1, length=9)
    vector.reset()
    wait = vector.signal.__class__.wait

    def stop(signal: Any, *args: Any) -> None:
        monkeypatch.setattr(vector.signal.__class__, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(vector.signal.__class__, "wait", stop)
    with pytest.raises(KeyboardInterrupt):
        vector.recv() if vector.under_way else vector.step(["a"] * 3)
    assert sorted(vector.recv(min_envs=3).slots) == [0, 1, 2]
    vector.close()


def test_plan_goes_on_behind_an_interrupt() -> None:
    """An interrupt loses what was being drawn, not the rest of the plan."""
    plan = [PlanItem(seed=number, repeat=2) for number in range(5)]
    line, place = 0, "begin"
    while place:
        vector = gem.make_vec(INLINE, 2, backend="sync", seed=1, plan=plan, length=1)
        place = interrupted(vector, lambda each: each.reset(), line)
        seeds: list[int] = []
        for _ in plan:
            seeds += [info["seed"] for info in vector.reset()[1] if "seed" in info]
        assert (len(seeds) >= 7, seeds[-1], seeds) == (True, 4, sorted(seeds)), place
        vector.close()
        line += 1


class PlanInTwoParts:
    """A plan of two items; whoever draws the second of the first run waits."""

    def __init__(self) -> None:
        self.runs = 0
        self.drawing, self.go_on = threading.Event(), threading.Event()

    def __iter__(self) -> Iterator[PlanItem]:
        """Yield the items of one run."""
        self.runs += 1
        first_run = self.runs == 1
        yield PlanItem(seed=1)
        if first_run:
            self.drawing.set()
            self.go_on.wait()
        yield PlanItem(seed=7 if first_run else 2)


def test_reset_waits_for_a_thread_that_takes_an_answer() -> None:
    """It has the answer already, and draws the next episode of a run that is left: nothing of that is seen."""
    plan = PlanInTwoParts()
    vector = gem.make_vec(THREAD, 1, backend="async", seed=1, plan=plan, length=1)
    vector.reset()
    vector.send(["a"])
    plan.drawing.wait()
    threading.Timer(0.05, plan.go_on.set).start()
    assert vector.reset(seed=1)[1][0]["seed"] == 1
    plan.go_on.wait()
    assert vector.start_of(0).seed == 1
    assert vector.step(["b"]).infos[0]["seed"] == 2
    vector.close()


def test_interrupt_of_the_lock_of_an_event_leaves_it_usable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python's own code is interrupted too: what holds a lock of an event there holds it for ever."""

    def enter(condition: Any) -> bool:
        condition._lock.acquire()
        raise KeyboardInterrupt

    vector = gem.make_vec(INLINE, 2, backend="sync", seed=1, length=9)
    expected = vector.reset()
    with monkeypatch.context() as patched, suppress(KeyboardInterrupt):
        patched.setattr(threading.Condition, "__enter__", enter)
        vector.send(["a"] * 2)
    assert vector.reset(seed=1) == expected
    vector.close()
