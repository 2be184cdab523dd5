"""The pool on a backend in memory: whom a machine goes to, what is kept ready, and that nothing is left."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import hypothesis.strategies as st
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from memory_backend import MemoryBackend, MemoryMachine, plain_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError, MachineError, MachineLostError
from gem_terminal.pool import MachinePool, Ticket

LIMITS = Limits(memory_mb=100)


class ByHand:
    """Background work that a test does when it likes."""

    def __init__(self) -> None:
        self.jobs: deque[Callable[[], object]] = deque()

    def __call__(self, job: Callable[[], object]) -> None:
        self.jobs.append(job)

    def work(self) -> None:
        """Do all that there is."""
        while self.jobs:
            self.jobs.popleft()()


class Setting:
    """A pool whose background work and clock are in a test's hand."""

    def __init__(self, **options: int) -> None:
        self.now = 0.0
        self.hand = ByHand()
        self.backend = MemoryBackend()
        self.pool = MachinePool(clock=lambda: self.now, submit=self.hand, most_memory_mb=10_000, **options)
        self.user = object()

    def ask(self, name: str = "one", ready: int = 1, user: object = None) -> Ticket:
        """Ask for a machine."""
        self.now += 1
        return self.pool.ask(user or self.user, self.backend, plain_task(name), LIMITS, ready=ready)


def test_take_gets_the_machine_that_was_made_ready_before() -> None:
    """The second reset does not wait for a start."""
    setting = Setting()
    first = setting.ask()
    assert not first.future.done()
    setting.hand.work()
    second = setting.ask()
    assert second.future.done()
    assert second.future.result() is not first.future.result()
    assert (setting.pool.counts().hits, setting.pool.counts().misses) == (1, 1)


def test_pool_of_none_makes_nothing_ready() -> None:
    """With a size of 0 there are the machines that were asked for, and no other."""
    setting = Setting()
    setting.ask(ready=0)
    setting.hand.work()
    assert len(setting.backend.made) == 1


def test_who_asks_first_is_served_first() -> None:
    """Machines go to waiting resets in their order."""
    setting = Setting()
    tickets = [setting.ask(ready=0) for _ in range(3)]
    for count in range(3):
        assert [ticket.future.done() for ticket in tickets] == [True] * count + [False] * (3 - count)
        setting.hand.jobs.popleft()()
    assert [ticket.future.result() for ticket in tickets] == setting.backend.made


def test_a_reset_goes_before_what_is_only_made_ready() -> None:
    """A start that is waited for is done before one that is not."""
    setting = Setting()
    setting.pool.prestart(setting.user, setting.backend, plain_task("spare"), LIMITS, ready=3)
    waited_for = setting.ask("urgent", ready=0)
    setting.hand.jobs.popleft()()
    assert waited_for.future.done()


def test_start_that_is_under_way_serves_the_reset_that_comes_meanwhile() -> None:
    """Nothing is started twice."""
    setting = Setting()
    setting.pool.prestart(setting.user, setting.backend, plain_task(), LIMITS, ready=1)
    ticket = setting.ask(ready=0)
    setting.hand.work()
    assert ticket.future.result() is setting.backend.made[0]
    assert len(setting.backend.made) == 1


def test_failing_start_is_raised_in_the_reset_that_waits() -> None:
    """Each gets an error of its own, and the next reset tries again."""
    setting = Setting()

    def fail(_: object) -> None:
        raise EngineError("no engine; start one")

    setting.backend.on_start = fail
    tickets = [setting.ask(ready=0) for _ in range(2)]
    setting.hand.work()
    errors = [ticket.future.exception() for ticket in tickets]
    assert [str(error) for error in errors] == ["no engine; start one"] * 2
    assert errors[0] is not errors[1]
    setting.backend.on_start = None
    again = setting.ask(ready=0)
    setting.hand.work()
    assert again.future.result() is setting.backend.made[0]


def test_failing_start_that_nobody_waits_for_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """It is not swallowed, and the next reset starts one itself."""
    setting = Setting()

    def fail(_: object) -> None:
        raise EngineError("no engine; start one")

    setting.backend.on_start = fail
    setting.pool.prestart(setting.user, setting.backend, plain_task(), LIMITS)
    with caplog.at_level(logging.WARNING):
        setting.hand.work()
    assert "a machine of the task one did not start: no engine; start one" in caplog.text
    assert setting.pool.counts().under_way == 0


def test_machine_that_was_lost_while_ready_is_never_handed_out() -> None:
    """A container that somebody killed is removed, and another started."""
    setting = Setting()
    setting.ask()
    setting.hand.work()
    ready = setting.backend.made[1]
    ready.lost = MachineLostError("killed")
    ticket = setting.ask(ready=0)
    setting.hand.work()
    assert ticket.future.result() is setting.backend.made[2]
    assert ready.removed == 1


def test_machine_unused_for_long_is_removed() -> None:
    """The time is that of being ready."""
    setting = Setting(idle_s=100)
    setting.ask()
    setting.hand.work()
    setting.now += 99
    setting.pool.sweep()
    assert setting.pool.counts().ready == 1
    setting.now += 1
    setting.pool.sweep()
    setting.hand.work()
    assert setting.pool.counts().ready == 0
    assert setting.backend.made[1].removed == 1


def test_task_asked_for_once_drives_nobody_out() -> None:
    """Where there is no room, only a task that is asked for more often takes another's place."""
    setting = Setting(most=1)
    setting.ask("one")
    setting.hand.work()
    setting.ask("two")
    setting.hand.work()
    assert setting.backend.made[1].task.name == "one"
    assert not setting.backend.made[1].removed
    setting.ask("two")
    setting.hand.work()
    assert setting.backend.made[1].removed
    assert setting.pool.counts().ready == 1


def test_memory_of_ready_machines_is_bounded() -> None:
    """The sum of their limits counts."""
    setting = Setting()
    setting.ask(ready=1_000)
    setting.hand.work()
    assert setting.pool.counts().ready == 32
    few = Setting()
    few.pool = MachinePool(submit=few.hand, most_memory_mb=350)
    few.ask(ready=10)
    few.hand.work()
    assert few.pool.counts().ready == 3


def test_leave_removes_what_nobody_else_uses() -> None:
    """Two environments on one task share what is ready; the last one to leave ends it."""
    setting = Setting()
    other = object()
    setting.ask()
    setting.ask(user=other)
    setting.hand.work()
    assert setting.pool.counts().ready == 1
    setting.pool.leave(setting.user, wait_s=0)
    setting.hand.work()
    assert setting.pool.counts().ready == 1
    setting.pool.leave(other, wait_s=0)
    setting.hand.work()
    assert sum(machine.removed for machine in setting.backend.made) == 1


def test_start_under_way_when_its_user_leaves_is_removed() -> None:
    """It arrives, and is gone."""
    setting = Setting()
    gate, started = threading.Event(), threading.Event()

    def held(_: object) -> None:
        started.set()
        gate.wait(20)

    setting.backend.on_start = held
    pool = MachinePool(starts=1)
    pool.prestart(setting.user, setting.backend, plain_task(), LIMITS)
    assert started.wait(20)
    threading.Timer(0.05, gate.set).start()
    pool.leave(setting.user)
    assert [machine.removed for machine in setting.backend.made] == [1]


def test_reset_that_waits_when_its_user_leaves_is_told() -> None:
    """Closing an environment ends a reset of it in another thread."""
    setting = Setting()
    ticket = setting.ask()
    setting.pool.leave(setting.user, wait_s=0)
    with pytest.raises(MachineError, match="the environment was closed while its machine was started"):
        ticket.future.result(0)


def test_withdrawn_ticket_leaves_nothing() -> None:
    """Ctrl-C in a reset: whether the machine was there already or not, it is removed."""
    setting = Setting()
    early, late = setting.ask(ready=0), setting.ask(ready=0)
    setting.pool.withdraw(early)
    setting.hand.work()
    setting.pool.withdraw(late)
    setting.hand.work()
    assert setting.backend.live == {}


def test_close_removes_everything_and_the_pool_goes_on() -> None:
    """All users' machines that are ready are gone; those that were taken are their takers'."""
    backend, pool = MemoryBackend(), MachinePool()
    taken = [pool.take(object(), backend, plain_task(name), LIMITS) for name in ("one", "two")]
    pool.close()
    assert sorted(backend.live) == sorted(machine.id for machine in taken)
    assert pool.take(object(), backend, plain_task(), LIMITS).why_lost() is None
    pool.close()


def test_many_threads_take_and_discard_and_nothing_is_left() -> None:
    """No machine goes to two, and all are removed at the end."""
    backend, pool = MemoryBackend(), MachinePool(most=4)
    seen: list[str] = []

    def episode(number: int) -> None:
        user = object()
        for turn in range(5):
            machine = pool.take(user, backend, plain_task(f"task {(number + turn) % 3}"), LIMITS)
            seen.append(machine.id)
            pool.discard(user, machine)
        pool.leave(user)

    with ThreadPoolExecutor(16) as threads:
        list(threads.map(episode, range(40)))
    assert len(seen) == len(set(seen)) == 200
    assert backend.live == {}
    assert all(machine.removed == 1 for machine in backend.made)


class PoolMachine(RuleBasedStateMachine):
    """Any order of asking, working, failing, ageing, leaving and withdrawing."""

    def __init__(self) -> None:
        super().__init__()
        self.setting = Setting(most=3, idle_s=50)
        self.users = [object(), object(), object()]
        self.tickets: list[Ticket] = []
        self.held: dict[str, MemoryMachine] = {}
        self.fail = False
        self.setting.backend.on_start = self._on_start

    def _on_start(self, _: object) -> None:
        if self.fail:
            self.fail = False
            raise EngineError("this one fails")

    @rule(user=st.integers(0, 2), task=st.sampled_from("abcd"), ready=st.integers(0, 2))
    def ask(self, user: int, task: str, ready: int) -> None:
        """A reset begins."""
        self.tickets.append(self.setting.ask(task, ready, self.users[user]))

    @precondition(lambda self: self.setting.hand.jobs)
    @rule(which=st.integers(0, 50), fails=st.booleans())
    def work(self, which: int, fails: bool) -> None:
        """Some background work is done, in any order."""
        jobs = self.setting.hand.jobs
        jobs.rotate(-(which % len(jobs)))
        self.fail = fails
        jobs.popleft()()
        self.fail = False

    @rule(seconds=st.integers(1, 100))
    def age(self, seconds: int) -> None:
        """Time passes."""
        self.setting.now += seconds
        self.setting.pool.sweep()

    @rule(user=st.integers(0, 2))
    def leave(self, user: int) -> None:
        """An environment is closed."""
        self.setting.pool.leave(self.users[user], wait_s=0)

    @precondition(lambda self: self.tickets)
    @rule(which=st.integers(0, 50))
    def withdraw(self, which: int) -> None:
        """A reset is interrupted."""
        ticket = self.tickets.pop(which % len(self.tickets))
        if not (ticket.future.done() and ticket.future.exception()):
            self.setting.pool.withdraw(ticket)

    @precondition(lambda self: self.setting.backend.live)
    @rule(which=st.integers(0, 50))
    def kill(self, which: int) -> None:
        """A machine is lost."""
        live = list(self.setting.backend.live.values())
        live[which % len(live)].lost = MachineLostError("killed")

    @invariant()
    def nobody_shares(self) -> None:
        """Each machine goes to one ticket, and is not removed while that holds it."""
        held = [t.future.result() for t in self.tickets if t.future.done() and not t.future.exception()]
        assert len({machine.id for machine in held}) == len(held)
        assert not any(machine.removed for machine in held)

    @invariant()
    def bounded(self) -> None:
        """No more is ready than there may be."""
        counts = self.setting.pool.counts()
        assert counts.ready <= 3
        assert counts.under_way >= 0

    def teardown(self) -> None:
        """All that waits is served in the end, and nothing is left."""
        self.setting.hand.work()
        assert all(ticket.future.done() for ticket in self.tickets)
        for ticket in self.tickets:
            if not ticket.future.exception():
                self.setting.pool.discard(self.setting.user, ticket.future.result())
        self.setting.pool.close(wait_s=0)
        self.setting.hand.work()
        assert self.setting.backend.live == {}
        assert all(machine.removed == 1 for machine in self.setting.backend.made)


TestPoolMachine = PoolMachine.TestCase
TestPoolMachine.settings = settings(stateful_step_count=40)
