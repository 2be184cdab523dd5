"""The public names, which are imported on first use."""

from .dataset import (
    DatasetEnv as DatasetEnv,
    DatasetOptions as DatasetOptions,
    Grade as Grade,
    chosen_index as chosen_index,
)
from .rows import Row as Row, RowFunction as RowFunction, RowSource as RowSource, load_rows as load_rows
