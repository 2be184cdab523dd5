"""What tasks get of what they ask for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from memory_backend import plain_task

from gem_terminal.backends.interface import Limits, Resources
from gem_terminal.tasks.task import Container, Environment

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

BIG = Container(cpus=4, memory_mb=4096, storage_mb=10_240)
SMALL = Container(cpus=0.5, memory_mb=100, storage_mb=10)
HERE = Resources(8, 16_384)


def task_of(container: Container, **services: Container) -> Task:
    """Return a task of containers."""
    return replace(plain_task(), environment=Environment(container, services))


@pytest.mark.parametrize(
    ("limits", "container", "there", "gets"),
    [
        (Limits(), BIG, HERE, (4, 4096, 10_240)),
        (Limits(), SMALL, HERE, (0.5, 100, 10)),
        (Limits(), Container(), HERE, (1, 2048, 4096)),
        (Limits(), BIG, Resources(2, 3000), (2, 3000, 10_240)),
        (Limits(cpus=3, memory_mb=512, storage_mb=20), BIG, HERE, (3, 512, 20)),
        (Limits(cpus=3, memory_mb=512, storage_mb=20), SMALL, HERE, (0.5, 100, 10)),
        (Limits(cpus=3, memory_mb=8192, storage_mb=20), Container(), HERE, (3, 8192, 20)),
    ],
)
def test_a_task_gets_what_it_asks_for_up_to_what_there_is_and_is_allowed(
    limits: Limits, container: Container, there: Resources, gets: tuple[float, ...]
) -> None:
    """One that asks for nothing gets what is allowed, or the usual."""
    assert limits.share(container, there) == gets


def test_reset_says_what_a_task_does_not_get(make: Any, caplog: pytest.LogCaptureFixture) -> None:
    """In ``info``, and once as a warning."""
    env = make(task_of(BIG))
    for _ in range(2):
        _, info = env.reset()
        assert "4 processors" in info["terminal"]["shortfall"][0]
    assert caplog.text.count("4 processors") == 1
    (said,) = Limits(memory_mb=16).shortfall(task_of(Container(), helper=SMALL), HERE)
    assert "'helper'" in said
    assert "memory_mb=16" in said
