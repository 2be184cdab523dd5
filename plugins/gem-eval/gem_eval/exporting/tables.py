"""The episodes of runs as a table (pandas, CSV), and as a file of ``gem run``."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core import Episode
from gem_core.errors import MissingRequirementError
from gem_core.records import ImageFolder, record_from_dict, whole_file
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


def write_jsonl(runs: Sequence[Run], path: Path) -> int:
    """Write the episodes of runs as ``gem run`` does, their images beside them, and return their number.

    What a run says of an episode besides stays under ``"evaluation"``, so that ``open_run`` of the file finds the same
    rows. A damaged episode is left out, and noted in ``Run.damage``.

    Args:
        runs: The runs.
        path: The file.

    Raises:
        EpisodeFileError: A run cannot be read.
        OSError: The file cannot be written.
    """
    count = 0
    images = ImageFolder.beside(path)

    def record(run: Run, row: Row) -> dict[str, Any]:
        line = run.line(row)
        told = {"evaluation": line["evaluation"]} if "evaluation" in line else {}
        return record_from_dict(line, run.images).to_dict(images) | told

    with whole_file(path) as file:
        for run in runs:
            whole = {row.number: row for row in run.rows}  # of several agents, the seats share a line
            for _, each in run.intact(whole.values(), partial(record, run)):
                file.write(json.dumps(each, ensure_ascii=True, allow_nan=False).encode("ascii") + b"\n")
                count += 1
    return count


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
