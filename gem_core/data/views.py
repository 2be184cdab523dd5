"""Sequences of rows that are made from others without copying a row."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

from gem_core.errors import DatasetError

Row = Mapping[str, Any]
"""A row of a data set: columns and their values."""


class Rows(Sequence[Row]):
    """A sequence of rows; a subclass has ``__len__`` and ``row``, which is called with an index that is in range."""

    @abstractmethod
    def row(self, index: int) -> Row:
        """Return a row, by an index from 0 to one less than the length."""

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | Sequence[Row]:
        """Return a row, or several as a list."""
        if isinstance(index, slice):
            return [self.row(place) for place in range(*index.indices(len(self)))]
        place = index + len(self) if index < 0 else index
        if not 0 <= place < len(self):
            raise IndexError(f"there is no row {index}; there are {len(self)}")
        return self.row(place)


class SelectedRows(Rows):
    """Some rows of a sequence, in the order of their indices.

    Args:
        rows: Where they are taken from.
        indices: Which.
    """

    def __init__(self, rows: Sequence[Row], indices: Sequence[int]) -> None:
        self._rows, self._indices = rows, indices

    def __len__(self) -> int:
        return len(self._indices)

    def row(self, index: int) -> Row:
        """Return a row."""
        return self._rows[self._indices[index]]


class MappedRows(Rows):
    """The rows of a sequence, each changed by a function whenever it is asked for.

    Args:
        rows: Where they are taken from.
        change: Called with a row, returns the row to use instead.
    """

    def __init__(self, rows: Sequence[Row], change: Callable[[Row], Row]) -> None:
        self._rows, self._change = rows, change

    def __len__(self) -> int:
        return len(self._rows)

    def row(self, index: int) -> Row:
        """Return a row.

        Raises:
            DatasetError: The function failed, or returned no row.
        """
        row = call_on_row(self._change, self._rows[index], index, "map_row")
        if not isinstance(row, Mapping):
            raise DatasetError(f"map_row must return a mapping of columns to values, not a {type(row).__name__}")
        return row


def call_on_row(function: Callable[[Row], Any], row: Row, index: int, what: str) -> Any:
    """Call a user's function with a row.

    Raises:
        DatasetError: It failed; the message tells which function, why, and the columns of the row.
    """
    try:
        return function(row)
    except Exception as error:  # a function of somebody else's may fail in any way
        columns = ", ".join(map(repr, row)) if isinstance(row, Mapping) else f"none: it is a {type(row).__name__}"
        raise DatasetError(
            f"{what} failed on row {index}: {type(error).__name__}: {error}. Columns: {columns}"
        ) from error
