"""``load_rows``: rows of a data set from memory, from JSON, or from whatever the package ``datasets`` loads."""

from __future__ import annotations

import csv
import glob
import gzip
import importlib.util
import json
import os
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from gem_core.errors import ArgumentError, DatasetError, MissingRequirementError
from gem_core.failures import shown_error
from gem_core.registry.entry_points import load_entry_point
from gem_core.suggestions import did_you_mean

Row = Mapping[str, Any]
"""A row of a data set: columns and their values."""

RowSource = str | Path | Sequence[Row]
"""A name on the hub, a path, a ``datasets.Dataset`` or ``DatasetDict``, or any sequence of mappings."""

RowFunction = str | Callable[[Row], Any]
"""A function of one row, or where to find it: ``"package.module:function"``."""

ENDINGS = (".jsonl", ".ndjson", ".json", ".csv", ".tsv", ".parquet", ".arrow")
"""Endings of the files that hold rows."""

_HUB_NAME = re.compile(r"[\w.-]+(/[\w.-]+)?", re.ASCII)
_SHIPPED = re.compile(r"(?P<package>[A-Za-z_]\w*):(?P<inside>[\w-][\w./-]*)", re.ASCII)

# Held while rows are loaded or filtered, so that environments made at the same time in many threads do it once.
_lock = threading.RLock()


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

    What is named is loaded once in a process for all that ask for it, and again after a file was changed; the sets used
    last are kept. JSON is held in memory; all else is loaded by the package ``datasets``, and stays mapped from its
    cache. Without a network, set ``HF_HUB_OFFLINE=1``: ``datasets`` then reads its cache at once, else after 23 s.

    Args:
        source: The path of a file of JSON lines, JSON, CSV, TSV (as text), Parquet or Arrow, each ``.gz`` too; of a
            folder of these, one or more for each split; or of a folder that ``datasets`` saved. Or
            ``"package:data/rows.jsonl"``, which a package ships. Else the name of a data set on the Hugging Face hub,
            as in ``"openai/gsm8k"``. Or the rows themselves.
        split: Which split, or part of one, as ``datasets`` writes it: ``"test"``, ``"train[:10%]"``. None if there is
            but one. A lone file is the split ``"train"``.
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
    keep = None if row_filter is None else load_entry_point(row_filter, "row_filter")
    change = None if map_row is None else load_entry_point(map_row, "map_row")
    rows: Sequence[Row]
    if isinstance(source, str | os.PathLike):
        path = _local_path(source)
        if path is not None and path.is_file() and (config or revision):
            raise ArgumentError(f"config and revision choose from a data set on the hub, and {str(path)!r} is here")
        with _lock:
            asked = (path or str(source), _stamp(path), split, config, revision)
            rows = _load(*asked) if keep is None else _load_filtered(keep, *asked)
    else:
        if config or revision or (split and not isinstance(source, Mapping)):
            raise ArgumentError("split, config and revision choose from a named data set, and rows were given")
        is_dictionary = bool(source) and isinstance(source, Mapping)
        rows = _one_split(source, "the dictionary", split) if is_dictionary else source
        if not hasattr(rows, "__len__") or not hasattr(rows, "__getitem__"):
            raise DatasetError(f"rows must be a sequence of mappings, not {type(rows).__name__}")
        if keep is not None:
            rows = _filtered(rows, keep)
        elif not isinstance(rows, Sequence):  # a data set of ``datasets``, whose slices are columns
            rows = _View(rows, range(len(rows)))
    return rows if change is None else _View(rows, range(len(rows)), change)


def ending(path: Path) -> str:
    """Return the ending that tells the format of a file, without ``.gz``."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


class _View(Sequence[Row]):
    """Some of the rows, changed when they are asked for."""

    def __init__(self, rows: Sequence[Row], indices: Sequence[int], change: Callable[[Row], Any] | None = None) -> None:
        self._rows, self._indices, self._change = rows, indices, change

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return _View(self._rows, self._indices[index], self._change)
        number = self._indices[index]
        if self._change is None:
            return self._rows[number]
        row = _call_with_row("map_row", self._change, self._rows, number)
        if not isinstance(row, Mapping):
            raise DatasetError(f"map_row must return a mapping of columns to values, not a {type(row).__name__}")
        return row


def _filtered(rows: Sequence[Row], keep: Callable[[Row], Any]) -> Sequence[Row]:
    indices = [index for index in range(len(rows)) if _call_with_row("row_filter", keep, rows, index)]
    if not indices:
        raise DatasetError(f"row_filter leaves none of the {len(rows)} rows")
    return _View(rows, indices)


def _call_with_row(what: str, function: Callable[[Row], Any], rows: Sequence[Row], index: int) -> Any:
    """Call a user's function with a row."""
    row = rows[index]
    try:
        return function(row)
    except Exception as error:  # a user's function may raise anything
        raise DatasetError(f"{what} failed on row {index}: {shown_error(error)}. The row: {row!r:.200}") from error


def _local_path(source: str | os.PathLike[str]) -> Path | None:
    """Return where a data set is on this machine, or None for a name on the hub."""
    name = os.fspath(source)
    if isinstance(source, str) and (shipped := _SHIPPED.fullmatch(source)):
        package = importlib.util.find_spec(shipped["package"])
        if package is None or not package.submodule_search_locations:
            raise DatasetError(f"there is no package {shipped['package']!r}, so that {source} is nowhere")
        name = os.path.join(package.submodule_search_locations[0], shipped["inside"])
    path = Path(os.path.realpath(os.path.expanduser(name)))
    if os.path.isdir(path) and name:
        return path
    if os.path.isfile(path):
        if ending(path) not in ENDINGS:
            raise DatasetError(f"{name!r} has an ending that is not known; known are: {', '.join(ENDINGS)}")
        return path
    if _HUB_NAME.fullmatch(name) and ending(path) not in ENDINGS:
        return None
    near = next(folder for folder in path.parents if os.path.isdir(folder))
    there = ", ".join(sorted(os.listdir(near))[:10]) or "nothing"
    raise DatasetError(f"no file or folder {name!r:.200}, and no name of the hub. In {str(near)!r} there is: {there}")


def _stamp(path: Path | None) -> tuple[tuple[str, int, int], ...]:
    """Return a value that changes whenever a file, or one in a folder, changes."""
    files = [] if path is None else [(str(file), file.stat()) for file in sorted([path, *path.rglob("*")])]
    return tuple((name, status.st_size, status.st_mtime_ns) for name, status in files)


@lru_cache(maxsize=8)
def _load_filtered(keep: Callable[[Row], Any], *asked: Any) -> Sequence[Row]:
    return _filtered(_load(*asked), keep)


@lru_cache(maxsize=8)
def _load(source: str | Path, stamp: object, split: str | None, config: str | None, revision: str | None) -> Any:
    """Load a path, or a name on the hub; ``stamp`` is a part of the cache's key."""
    is_file = isinstance(source, Path) and source.is_file()
    if is_file and split is None and str(source).endswith((".jsonl", ".ndjson", ".json")):
        return _json_rows(Path(source))
    try:
        import datasets  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        if error.name != "datasets":
            raise
        raise MissingRequirementError(f"to load {str(source)!r}: pip install 'gem-core[datasets]'") from error
    try:
        if is_file:
            kind, options = _file_options(Path(source), datasets)
            loaded = datasets.load_dataset(kind, data_files=glob.escape(str(source)), split=split, **options)
        elif os.path.isfile(f"{source}/state.json") or os.path.isfile(f"{source}/dataset_dict.json"):
            loaded = datasets.load_from_disk(str(source))
            loaded = loaded if isinstance(loaded, Mapping) else {str(loaded.split or "train"): loaded}
        else:
            loaded = datasets.load_dataset(str(source), config, split=split, revision=revision)
    except Exception as error:  # each of a dozen readers fails with exceptions of its own
        chosen = "".join(f", {name} {value!r}" for name, value in (("split", split), ("config", config)) if value)
        advice = "; go online once, or give the path of a local copy" if isinstance(error, ConnectionError) else ""
        cause = shown_error(error.__cause__ or error)
        raise DatasetError(f"the data set {str(source)!r}{chosen} cannot be loaded: {cause}{advice}") from error
    rows = _one_split(loaded, repr(str(source)), split) if isinstance(loaded, Mapping) else loaded
    return _View(rows, range(len(rows)))


def _one_split(loaded: Any, name: str, split: str | None) -> Any:
    """Return one of several data sets by the name of its split."""
    names = ", ".join(map(repr, loaded))
    if split is None and len(loaded) > 1:
        raise DatasetError(f"{name} has several splits; choose one with split=: {names}")
    if split is not None and split not in loaded:
        raise DatasetError(f"no split {split!r} in {name}.{did_you_mean(split, loaded)} Splits: {names}")
    return loaded[split or next(iter(loaded))]


def _file_options(path: Path, datasets: Any) -> tuple[str, dict[str, Any]]:
    """Return the format of a file, as ``datasets`` calls it, and the options to read it with."""
    kind = ending(path)
    if kind not in (".csv", ".tsv"):
        return {".jsonl": "json", ".ndjson": "json"}.get(kind, kind[1:]), {}
    # All columns as text: by themselves, an answer 007 would be the number 7, and NA nothing.
    separator = "," if kind == ".csv" else "\t"
    opener: Any = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt", encoding="utf-8-sig", newline="") as file:
        columns = [name for name in next(csv.reader(file, delimiter=separator), []) if name]
    features = datasets.Features({name: datasets.Value("string") for name in columns})
    return "csv", {"sep": separator, "features": features, "keep_default_na": False, "index_col": False}


def _json_rows(path: Path) -> list[Row]:
    """Read lines of JSON objects, or one list of objects.

    ``datasets`` reads JSON too, but its parser ends the whole process on brackets that are nested 100,000 deep.
    """
    where = str(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        if text.lstrip().startswith("["):
            rows = json.loads(text)
        else:
            rows = []
            for number, line in enumerate(text.split("\n"), 1):
                where = f"{path}, line {number}"
                if line.strip():
                    rows.append(json.loads(line))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{where} cannot be read as JSON: {error}") from error
    for index, row in enumerate(rows):
        if not isinstance(row, dict):
            raise DatasetError(f'{path}, row {index} must be an object, as {{"question": …}}, not {row!r:.60}')
    return cast("list[Row]", rows)
