"""What a worker notes of its commands, in memory that is shared."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

from gem_core.vector.worker import SharedTimes


class GoingOn(SharedTimes):
    """As the host sees it while the worker ends each command between one look and the next."""

    def __iter__(self) -> Iterator[int]:
        slots = list(super().__iter__())
        for slot in slots:
            del self[slot]
        return iter(slots)


def test_times_are_read_at_once() -> None:
    """A command that ends while the host looks is no error."""
    with tempfile.TemporaryFile() as file:
        file.truncate(24)
        times = GoingOn(file.fileno(), 3)
        times[0], times[2] = 1.5, 2.5
        assert times.present() == {0: 1.5, 2: 2.5}
