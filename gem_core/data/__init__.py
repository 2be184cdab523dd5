"""Data sets: environments that ask their rows, and functions that load rows."""

from __future__ import annotations

from gem_core.data.dataset import DatasetEnv, DatasetOptions, Grade, chosen_index
from gem_core.data.loading import RowFunction, RowSource, load_rows
from gem_core.data.rows import Row, Rows

__all__ = [
    "DatasetEnv",
    "DatasetOptions",
    "Grade",
    "Row",
    "RowFunction",
    "RowSource",
    "Rows",
    "chosen_index",
    "load_rows",
]
