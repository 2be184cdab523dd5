"""The pool on a backend in memory: whom a machine goes to, what is kept ready, and when all of it is removed."""

from __future__ import annotations

import gc
import logging
import os
import random
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from memory_backend import MemoryBackend, MemoryMachine, plain_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError, MachineLostError
from gem_terminal.pool import Holdings, MachinePool

LIMITS = Limits(memory_mb=100)


class Owner:
    """Stands for an environment."""


class Setting:
    """A pool on a backend in memory, and one who takes machines."""

    def __init__(self, **options: Any) -> None:
        self.backend = MemoryBackend()
        self.pool = MachinePool(**options)
        self.user = Owner()

    def take(self, name: str = "one", ready: int = 0, user: object = None) -> Any:
        """Take a machine."""
        return self.pool.take(user or self.user, self.backend, plain_task(name), LIMITS, ready=ready)

    def prestart(self, ready: int = 1, user: object = None) -> None:
        """Have machines made ready."""
        self.pool.prestart(user or self.user, self.backend, plain_task(), LIMITS, ready=ready)

    def made(self, count: int) -> list[MemoryMachine]:
        """Wait until so many machines were made, and return all."""
        assert until(lambda: len(self.backend.made) >= count)
        return self.backend.made

    def prestart_held(self) -> None:
        """Have a machine made ready whose start takes a while, and return when it has begun."""
        gate, started = threading.Event(), threading.Event()
        self.backend.on_start = lambda _: (started.set(), gate.wait(30))
        self.prestart()
        assert started.wait(30)
        threading.Timer(0.05, gate.set).start()


def until(holds: Callable[[], bool]) -> bool:
    """Wait for something that happens in another thread."""
    pause = threading.Event()
    return any(holds() or pause.wait(0.01) for _ in range(3000))


def fail(_: object) -> None:
    """Start no machine."""
    raise EngineError("no engine; start one")


@pytest.fixture
def setting() -> Iterator[Setting]:
    """Give a setting, and find nothing ready in the end."""
    setting = Setting()
    yield setting
    setting.pool.leave(setting.user)
    assert all(machine.removed <= 1 for machine in setting.backend.made)


def test_take_gets_the_machine_that_was_made_ready_before(setting: Setting) -> None:
    """The second reset does not wait for a start."""
    first = setting.take(ready=1)
    spare = setting.made(2)[1]
    assert setting.take(ready=0) is spare is not first
    assert len(setting.backend.made) == 2


def test_start_under_way_when_its_user_leaves_is_removed(setting: Setting) -> None:
    """It arrives, and is gone."""
    setting.prestart_held()
    setting.pool.leave(setting.user)
    assert [machine.removed for machine in setting.backend.made] == [1]


def test_failing_start_is_raised_in_the_reset_that_waits(setting: Setting, caplog: pytest.LogCaptureFixture) -> None:
    """One that nobody waits for is logged; the next reset tries again."""
    setting.backend.on_start = fail
    with pytest.raises(EngineError, match="no engine; start one"):
        setting.take()
    with caplog.at_level(logging.WARNING):
        setting.prestart()
        assert until(lambda: "no engine; start one" in caplog.text)
    setting.backend.on_start = None
    assert setting.take() in setting.backend.made


def test_machine_that_was_lost_while_ready_is_never_handed_out(setting: Setting) -> None:
    """A container that somebody killed is removed, and another started."""
    setting.prestart()
    ready = setting.made(1)[0]
    ready.lost = MachineLostError("killed")
    assert setting.take() is not ready
    assert until(lambda: ready.removed == 1)


def test_machine_unused_for_long_makes_room() -> None:
    """As where there is room for one alone, and another task is asked for."""
    setting = Setting(most=1, idle_s=0.0)
    setting.prestart()
    setting.made(1)
    assert until(lambda: setting.take("two", ready=1).task.name == "two" and setting.backend.made[0].removed == 1)
    setting.pool.leave(setting.user)


def test_number_and_memory_of_ready_machines_are_bounded() -> None:
    """The sum of their limits counts."""
    for options, most in (({"most_memory_mb": 10_000}, 32), ({"most_memory_mb": 350}, 3), ({"most": 2}, 2)):
        setting = Setting(**options)
        setting.prestart(ready=1_000)
        assert len(setting.made(most)) == most
        setting.pool.leave(setting.user)
        assert len(setting.backend.made) == most
        assert setting.backend.live == {}


def test_leave_removes_what_nobody_else_uses(setting: Setting) -> None:
    """Two environments on one task share what is ready; the last one to leave ends it."""
    other = Owner()
    setting.prestart()
    setting.prestart(user=other)
    (machine,) = setting.made(1)
    setting.pool.leave(setting.user)
    assert not machine.removed
    setting.pool.leave(other)
    assert machine.removed == 1


def test_many_threads_take_and_discard_and_nothing_is_left() -> None:
    """No machine goes to two, and all are removed at the end; starts fail and machines are lost meanwhile."""
    setting = Setting(most=4, idle_s=0.01)
    draw = random.Random(1)
    seen: list[str] = []
    setting.backend.on_start = lambda task: fail(task) if draw.random() < 0.1 else None

    def episodes(number: int) -> None:
        user = Owner()
        for turn in range(20):
            try:
                machine = setting.take(f"task {(number + turn) % 3}", ready=1, user=user)
            except EngineError:
                continue
            seen.append(machine.id)
            for other in list(setting.backend.live.values())[:1] if draw.random() < 0.2 else ():
                other.lost = MachineLostError("killed")
            setting.pool.discard(user, machine)
        setting.pool.leave(user)

    with ThreadPoolExecutor(16) as threads:
        list(threads.map(episodes, range(40)))
    assert len(seen) == len(set(seen)) > 600
    assert setting.backend.live == {}
    assert all(machine.removed == 1 for machine in setting.backend.made)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on this system")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_release_removes_all_and_may_be_called_again() -> None:
    """Also what was only made ready; a forked child removes nothing of its parent."""
    setting = Setting()
    holdings = Holdings(setting.user, setting.pool)
    machine = holdings.take(setting.backend, plain_task(), LIMITS, 2)
    child = os.fork()
    if child == 0:
        there = len(setting.backend.live)
        holdings.release()
        os._exit(0 if len(setting.backend.live) == there else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    holdings.release()
    holdings.release()
    assert setting.backend.live == {}
    holdings.give_back(machine)
    assert machine.removed == 1


def test_forgotten_owner_gives_back_everything() -> None:
    """The garbage collector is enough."""
    setting = Setting()
    Holdings(setting.user, setting.pool).take(setting.backend, plain_task(), LIMITS, 0)
    setting.user = None
    gc.collect()
    assert until(lambda: setting.backend.live == {})


def test_start_that_is_under_way_serves_the_reset_that_comes_meanwhile(setting: Setting) -> None:
    """Nothing is started twice."""
    setting.prestart_held()
    assert setting.take() is setting.backend.made[0]
    assert len(setting.backend.made) == 1
