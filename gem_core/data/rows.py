"""``Rows``: a sequence whose rows are made when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
"""A row of a data set: columns and their values."""


class Rows(Sequence[Row]):
    """Rows that are made from items, one from each, whenever they are asked for.

    Args:
        items: What the rows are made from, in their order.
        make: Called with an item, returns its row.
    """

    def __init__(self, items: Sequence[Any], make: Callable[[Any], Row]) -> None:
        self._items, self._make = items, make

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: Any) -> Any:
        """Return a row, or some of them."""
        if isinstance(index, slice):
            return Rows(self._items[index], self._make)
        return self._make(self._items[index])
