"""What an environment holds is given back when it is closed or forgotten; a forked child gives back nothing."""

from __future__ import annotations

import gc
import os
import threading

import pytest
from memory_backend import MemoryBackend, plain_task

from gem_terminal.backends.interface import Limits
from gem_terminal.holdings import Holdings
from gem_terminal.pool import MachinePool


class Owner:
    """Stands for an environment."""


def test_release_removes_all_and_may_be_called_again() -> None:
    """Also what was only made ready."""
    backend, pool, owner = MemoryBackend(), MachinePool(), Owner()
    holdings = Holdings(owner, pool)
    machine = holdings.take(backend, plain_task(), Limits(), 2)
    holdings.release()
    holdings.release()
    assert backend.live == {}
    holdings.give_back(machine)
    assert machine.removed == 1


def test_forgotten_owner_gives_back_everything() -> None:
    """The garbage collector is enough."""
    gone = threading.Event()
    backend, pool = MemoryBackend(), MachinePool()

    def make() -> None:
        owner = Owner()
        Holdings(owner, pool).take(backend, plain_task(), Limits(), 0)
        machine = backend.made[0]
        remove = machine.remove
        machine.remove = lambda: (remove(), gone.set())  # type: ignore[method-assign, assignment, return-value]

    make()
    gc.collect()
    assert gone.wait(30)
    assert backend.live == {}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork on this system")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_forked_child_removes_nothing_of_its_parent() -> None:
    """What is there belongs to the parent, which goes on with it."""
    backend, pool, owner = MemoryBackend(), MachinePool(), Owner()
    holdings = Holdings(owner, pool)
    holdings.take(backend, plain_task(), Limits(), 0)
    child = os.fork()
    if child == 0:
        holdings.release()
        os._exit(0 if len(backend.live) == 1 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    holdings.release()
