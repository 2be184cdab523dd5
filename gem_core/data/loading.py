"""``load_rows``: loads the rows of a data set from any source, once for all environments that use it."""

from __future__ import annotations

import os
import re
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast
from weakref import WeakValueDictionary

from gem_core.data.files import TEXT_ENDINGS, ending, local_path, read_text, stamp
from gem_core.data.hub import dataset_rows, is_from_datasets, load_with_datasets, one_split
from gem_core.data.rows import Row, Rows
from gem_core.errors import ArgumentError, DatasetError
from gem_core.registry.entry_points import load_entry_point

RowSource = str | Path | Sequence[Row]
"""A name on the hub, a path, a ``datasets.Dataset`` or ``DatasetDict``, or any sequence of mappings."""

RowFunction = str | Callable[[Row], Any]
"""A function of one row, or where to find it: ``"package.module:function"``."""

_PART = re.compile(r"(?P<split>[^\[\]]*)\[(?P<start>-?\d+%?)?:(?P<stop>-?\d+%?)?\]")
_HUB_PAUSE_S = 30.0


def load_rows(
    source: RowSource,
    *,
    split: str | None = None,
    config: str | None = None,
    revision: str | None = None,
    row_filter: RowFunction | None = None,
    map_row: RowFunction | None = None,
) -> Sequence[Row]:
    """Return the rows of a data set.

    Rows of the same source are loaded once in a process, and are shared by all that ask for them. Files of JSON and
    CSV are held in memory; all else is loaded by the package ``datasets``, and stays mapped from its cache. A file that
    was changed since is loaded anew. Without a network, set ``HF_HUB_OFFLINE=1``: ``datasets`` then reads its cache at
    once, else after 23 s.

    Args:
        source: A local path: a file of JSON lines or JSON (``.gz`` too), CSV, TSV, Parquet or Arrow; a folder of
            these, one or more for each split; or a folder that ``datasets`` saved. Or ``"package:data/rows.jsonl"``,
            which a package ships. Else the name of a data set on the Hugging Face hub, as in ``"openai/gsm8k"``.
            Or the rows themselves.
        split: Which split, as in ``"test"``; a part of one as in ``"test[:100]"`` or ``"train[:10%]"``. None where
            there is but one. A lone file is the split ``"train"``.
        config: Which subset.
        revision: Version on the hub: a branch, a tag or a commit.
        row_filter: Called with each row once; rows for which it is false are left out.
        map_row: Called with a row that is asked for, returns the one to use instead; after ``row_filter``.

    Raises:
        DatasetError: There are no such rows; the message names what is there.
        MissingRequirementError: The package ``datasets`` is needed, and not installed.
        EntryPointError: A function that is given by name is not there.
        ArgumentError: A value that is not accepted.
    """
    name, part = _split_and_part(split)
    keep, change = _function(row_filter, "row_filter"), _function(map_row, "map_row")
    with _lock:
        # The whole split.
        rows: Sequence[Row]
        if not isinstance(source, str | os.PathLike):
            rows = _given_rows(source, name, config, revision)
        elif (path := local_path(source)) is None:
            asked = str(source), name, config, revision
            rows = _shared(("hub", *asked), lambda: _hub_rows(*asked))
        else:
            there = f"what is on the hub, and {str(path)!r} is here"
            _refuse(there, config=config if path.is_file() else None, revision=revision)
            rows = _shared(("local", stamp(path), name, config), lambda: _local_rows(path, name, config))
        if isinstance(rows, Rows):
            _recent.append(rows)

        # What is asked for of it.
        if part is not None or keep is not None:
            key = ("selected", id(rows), len(rows), part, keep)
            rows = _shared(key, lambda: _select_rows(rows, part, keep, source))
    return rows if change is None else Rows(range(len(rows)), partial(_map_row, change, rows))


def _given_rows(source: Any, split: str | None, config: str | None, revision: str | None) -> Sequence[Row]:
    """Return rows that the caller passed, with faster access to those of a ``datasets.Dataset``."""
    if is_from_datasets(source, "DatasetDict"):
        source, split = one_split(source, "the dictionary of data sets", split), None
    _refuse("a named data set, and rows were given themselves", split=split, config=config, revision=revision)
    if not hasattr(source, "__len__") or not hasattr(source, "__getitem__"):
        raise DatasetError(f"rows must be a sequence of mappings, not {type(source).__name__}")
    if is_from_datasets(source, "Dataset"):
        return _shared(("given", source), lambda: dataset_rows(source))
    return cast("Sequence[Row]", source)


def _local_rows(path: Path, split: str | None, config: str | None) -> Rows:
    if path.is_dir():
        return load_with_datasets(path, split=split, config=config, revision=None)
    if split not in (None, "train"):
        raise DatasetError(
            f"no split {split!r} in {str(path)!r}: a lone file is the split 'train'; leave split away (split=None)"
        )
    if ending(path) in TEXT_ENDINGS:
        return read_text(path)
    return load_with_datasets(path, split=None, config=None, revision=None)


def _hub_rows(name: str, split: str | None, config: str | None, revision: str | None) -> Rows:
    asked = name, split, config, revision
    failed_at, message = _failures.get(asked, (float("-inf"), ""))
    if time.monotonic() - failed_at < _HUB_PAUSE_S:
        raise DatasetError(message)
    try:
        return load_with_datasets(name, split=split, config=config, revision=revision)
    except DatasetError as error:
        _failures[asked] = (time.monotonic(), str(error))
        raise


def _refuse(what: str, **choices: str | None) -> None:
    """Raise for a choice that would be ignored."""
    for name, value in choices.items():
        if value is not None:
            raise ArgumentError(f"{name} chooses from {what}; leave it away")


def _split_and_part(split: str | None) -> tuple[str | None, tuple[str | None, str | None] | None]:
    if split is None:
        return None, None
    if not isinstance(split, str) or not split:
        raise ArgumentError(f"split must be the name of a split, as in 'train', or None, not {split!r}")
    match = _PART.fullmatch(split)
    # A sum of splits, and of parts of them, is read by ``datasets``.
    if match is None and "+" not in split and ("[" in split or "]" in split):
        raise ArgumentError(f"a part of a split is written as in 'train[:100]' or 'train[10%:20%]', not {split!r}")
    return (split, None) if match is None else (match["split"] or None, (match["start"], match["stop"]))


def _select_rows(
    rows: Sequence[Row],
    part: tuple[str | None, str | None] | None,
    keep: Callable[[Row], Any] | None,
    source: RowSource,
) -> Rows:
    """Return the rows of a part of a split for which the filter is true."""
    indices: Sequence[int] = range(len(rows))
    if part is not None:
        indices = indices[slice(*(_slice_bound(text, len(rows)) for text in part))]
    if keep is not None and indices:
        total = len(indices)
        indices = array("q", (index for index in indices if _call_with_row("row_filter", keep, rows, index)))
        if not indices:
            where = f" of {str(source)!r}" if isinstance(source, str | os.PathLike) else ""
            raise DatasetError(f"row_filter leaves none of the {total} rows{where}")
    return Rows(indices, rows.__getitem__)


def _slice_bound(text: str | None, total: int) -> int | None:
    if text is None:
        return None
    return round(int(text[:-1]) * total / 100) if text.endswith("%") else int(text)


def _function(given: RowFunction | None, what: str) -> Callable[[Row], Any] | None:
    if given is None or callable(given):
        return given
    if not isinstance(given, str) or ":" not in given:
        raise ArgumentError(f"{what} must be a function or 'package.module:function', not {given!r}")
    return load_entry_point(given, what)


def _map_row(change: Callable[[Row], Any], rows: Sequence[Row], index: int) -> Row:
    row = _call_with_row("map_row", change, rows, index)
    if not isinstance(row, Mapping):
        raise DatasetError(f"map_row must return a mapping of columns to values, not a {type(row).__name__}")
    return row


def _call_with_row(what: str, function: Callable[[Row], Any], rows: Sequence[Row], index: int) -> Any:
    """Call a user's function with a row."""
    row = rows[index]
    try:
        return function(row)
    except Exception as error:  # a user's function may raise anything
        columns = ", ".join(map(repr, row)) if isinstance(row, Mapping) else f"none: it is a {type(row).__name__}"
        raise DatasetError(
            f"{what} failed on row {index}: {type(error).__name__}: {error}. Columns: {columns}"
        ) from error


_lock = threading.RLock()
"""Held while rows are loaded or filtered, so that environments made at the same time in many threads do it once."""
_rows_in_use: WeakValueDictionary[Hashable, Rows] = WeakValueDictionary()
"""Rows that are in use, by their source, filter and options; held weakly, so unused rows are freed."""
_recent: deque[Rows] = deque(maxlen=8)
"""Rows loaded last, kept so that ``make`` after ``close`` does not load the same rows again."""
_failures: dict[Hashable, tuple[float, str]] = {}
"""When the hub last failed, and how: offline, ``datasets`` tries for 23 s, and each of 64 environments would wait."""


def _shared(key: Hashable, load: Callable[[], Rows]) -> Rows:
    """Return rows that are in use, or load them."""
    try:
        rows = _rows_in_use.get(key)
    except TypeError:  # a filter that has no hash
        return load()
    if rows is None:
        rows = _rows_in_use[key] = load()
    return rows
