"""The public names, which are imported on first use."""

from .dataset import (
    DatasetEnv as DatasetEnv,
    DatasetOptions as DatasetOptions,
    Grade as Grade,
    chosen_index as chosen_index,
)
from .loading import RowFunction as RowFunction, RowSource as RowSource, load_rows as load_rows
from .rows import Row as Row, Rows as Rows
