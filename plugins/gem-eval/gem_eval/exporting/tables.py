"""The episodes of runs as a table: pandas, CSV and Parquet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core import Episode
from gem_core.errors import MissingRequirementError
from gem_core.records import whole_file
from gem_eval.opening import opened
from gem_eval.records import Row, Run
from gem_eval.turns import parts_of, text_of

if TYPE_CHECKING:
    import pandas as pd  # type: ignore[import-untyped]

_NOT_SHOWN = ("offset", "length", "group", "return_range", "seats")
_COLUMNS = {"run": "str"} | {
    each.name: str(each.type).removesuffix(" | None") for each in fields(Row) if each.name not in _NOT_SHOWN
}
"""Of each column its type: ``str``, ``bool``, ``int`` or ``float``. Any may be missing."""

_TEXTS = {"question": "str", "response": "str"}

_PANDAS_TYPES = {"str": "string", "bool": "boolean", "int": "Int64", "float": "float64"}

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a cell begins with that a spreadsheet would calculate."""


def to_pandas(run: Run | str | Path, *more: Run | str | Path, texts: bool = False) -> pd.DataFrame:
    """Return the episodes of one or several runs as a DataFrame.

    A row for each episode, as ``gem_eval.records.Row`` says it, after the name of its run. What is not known is missing
    (``NA``, or NaN of a float), not False or 0.

    Args:
        run: A run, or its path.
        more: Further runs.
        texts: Also the first observation (``question``) and the last response (``response``); each episode is read,
            and one that is damaged is left out, and noted in ``Run.damage``.

    Raises:
        MissingRequirementError: pandas is not installed.
        ArgumentError: There is no run.
        EpisodeFileError: A run cannot be read.
    """
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        raise MissingRequirementError("a DataFrame needs pandas: pip install 'gem-eval[pandas]'") from error
    columns, types = _columns(list(map(opened, (run, *more))), texts), _types(texts)
    return pd.DataFrame({name: pd.array(values, dtype=_PANDAS_TYPES[types[name]]) for name, values in columns.items()})


def write_csv(runs: Sequence[Run], path: Path, *, texts: bool = False) -> int:
    """Write the episodes of runs as CSV in UTF-8, and return their number.

    A text that a spreadsheet would take for a formula gets an apostrophe before it; numbers stay as they are. A missing
    value is an empty cell.

    Args:
        runs: The runs.
        path: The file.
        texts: See ``to_pandas``.

    Raises:
        EpisodeFileError: A run cannot be read.
        OSError: The file cannot be written.
    """
    columns = _columns(runs, texts)
    with whole_file(path) as file, io.TextIOWrapper(file, "utf-8", newline="") as text:
        writer = csv.writer(text)
        writer.writerow(columns)
        writer.writerows(map(_cell, record) for record in zip(*columns.values(), strict=True))
    return len(columns["run"])


def write_parquet(runs: Sequence[Run], path: Path, *, texts: bool = False) -> int:
    """Write the episodes of runs as Parquet, and return their number.

    Args:
        runs: The runs.
        path: The file.
        texts: See ``to_pandas``.

    Raises:
        MissingRequirementError: pyarrow is not installed.
        EpisodeFileError: A run cannot be read.
        OSError: The file cannot be written.
    """
    try:
        import pyarrow as pa  # type: ignore[import-untyped]
        import pyarrow.parquet as pq  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        raise MissingRequirementError("Parquet needs pyarrow: pip install 'gem-eval[parquet]'") from error
    types = {"str": pa.string(), "bool": pa.bool_(), "int": pa.int64(), "float": pa.float64()}
    schema = pa.schema([(name, types[kind]) for name, kind in _types(texts).items()])
    table = pa.table(_columns(runs, texts), schema=schema)
    with whole_file(path) as file:
        pq.write_table(table, file)
    return int(table.num_rows)


def _types(texts: bool) -> dict[str, str]:
    return _COLUMNS | _TEXTS if texts else _COLUMNS


def _columns(runs: Iterable[Run], texts: bool) -> dict[str, list[Any]]:
    """Return the values of each column, a value for each episode."""
    columns: dict[str, list[Any]] = {name: [] for name in _types(texts)}
    for run in runs:
        read = ((row, _texts(episode)) for row, episode in run.episodes()) if texts else ((row, ()) for row in run.rows)
        for row, more in read:
            own = [getattr(row, name) for name in _COLUMNS if name != "run"]
            for values, value in zip(columns.values(), [run.name, *own, *more], strict=True):
                values.append(_well_formed(value) if isinstance(value, str) else value)
    return columns


def _texts(episode: Episode) -> tuple[str, str | None]:
    return text_of(parts_of(episode.observation)), episode.transitions[-1].action.text if episode.transitions else None


def _cell(value: Any) -> Any:
    """Return the value of a cell that no spreadsheet takes for a formula; None is written as an empty cell."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _well_formed(text: str) -> str:
    """Return text without halves of characters, which UTF-8 cannot hold."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
