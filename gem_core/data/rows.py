"""``load_rows``: the rows of a data set, wherever they come from, shared by all that ask for the same."""

from __future__ import annotations

import importlib.util
import os
import re
import threading
import time
from array import array
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast
from weakref import WeakValueDictionary

from gem_core.data.files import TEXT_KINDS, read_text_rows, text_kind
from gem_core.data.hub import ArrowRows, binary_kind, is_dataset, load_dataset_rows, one_split
from gem_core.data.views import MappedRows, Row, Rows, SelectedRows, call_on_row
from gem_core.errors import ArgumentError, DatasetError
from gem_core.registry.entry_points import load_entry_point

RowSource = str | Path | Sequence[Row]
"""A name on the hub, a path, a ``datasets.Dataset`` or ``DatasetDict``, or any sequence of mappings."""

RowFunction = str | Callable[[Row], Any]
"""A function of one row, or where to find it: ``"package.module:function"``."""

_HUB_NAME = re.compile(r"[\w.-]+(/[\w.-]+)?", re.ASCII)
_PART = re.compile(r"(?P<split>[^\[\]]*)\[(?P<start>-?\d+%?)?:(?P<stop>-?\d+%?)?\]")
_SHIPPED = re.compile(r"(?P<package>[A-Za-z_]\w*):(?P<inside>[\w-][\w./-]*)", re.ASCII)
_KEPT = 8
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

    Rows of the same source are loaded once in a process, and are shared by all that ask for them: JSON lines stay in
    their file, what ``datasets`` loads stays mapped from its cache, other files are held in memory once. A file that
    was changed since is loaded anew.

    Args:
        source: A local path: a file of JSON, JSON lines, CSV or TSV (``.gz`` too), Parquet or Arrow; a folder of
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
    whole, part = _split_and_part(split)
    keep = _function(row_filter, "row_filter")
    change = _function(map_row, "map_row")
    rows = _loaded(source, whole, config, revision)
    if part is not None or keep is not None:
        key = ("part", id(rows), len(rows), part, row_filter)
        rows = _shared(key, lambda: _selected(rows, part, keep, source), lasting=False)
    return rows if change is None else MappedRows(rows, cast("Callable[[Row], Row]", change))


def _loaded(source: RowSource, split: str | None, config: str | None, revision: str | None) -> Sequence[Row]:
    if not isinstance(source, str | os.PathLike):
        return _given(source, split, config, revision)
    path = _local_path(source)
    if path is not None:
        return _local(path, split, config, revision)
    load = partial(load_dataset_rows, str(source), split=split, config=config, revision=revision)
    key = ("hub", str(source), split, config, revision)
    return _shared(key, lambda: _from_hub(key, load))


def _given(source: Any, split: str | None, config: str | None, revision: str | None) -> Sequence[Row]:
    """Return rows that were handed over, those of a ``datasets.Dataset`` with cheaper access to them."""
    if isinstance(source, Mapping) and source and all(map(is_dataset, source.values())):
        source, split = one_split(source, "the dictionary of data sets", split), None
    _refuse("a named data set, and rows were given themselves", split=split, config=config, revision=revision)
    if not hasattr(source, "__len__") or not hasattr(source, "__getitem__"):
        raise DatasetError(f"rows must be a sequence of mappings, not {type(source).__name__}")
    if is_dataset(source):
        return _shared(("dataset", id(source)), lambda: ArrowRows(source), lasting=False)
    return cast("Sequence[Row]", source)


def _local(path: Path, split: str | None, config: str | None, revision: str | None) -> Sequence[Row]:
    """Return the rows of a file or a folder, loaded anew when it has changed."""
    is_file = path.is_file()
    _refuse(f"what is on the hub, and {str(path)!r} is here", config=config if is_file else None, revision=revision)
    if is_file and text_kind(path):
        if split not in (None, "train"):
            raise DatasetError(
                f"no split {split!r} in {str(path)!r}: a lone file is the split 'train'; leave split away (split=None)"
            )
        return _shared(("file", path, _stamp(path)), lambda: read_text_rows(path))
    files = [path] if is_file else sorted(file for file in path.rglob("*") if file.is_file())
    return _shared(
        ("datasets", path, tuple(map(_stamp, files)), split, config),
        lambda: load_dataset_rows(path, split=split, config=config, revision=None),
    )


def _refuse(what: str, **choices: str | None) -> None:
    """Raise for a choice that would be ignored."""
    for name, value in choices.items():
        if value is not None:
            raise ArgumentError(f"{name} chooses from {what}; leave it away")


def _local_path(source: str | os.PathLike[str]) -> Path | None:
    """Return where a source lies on this machine, or None for a name on the hub."""
    known = (*TEXT_KINDS, ".parquet", ".arrow")
    if not str(source):
        raise DatasetError("the name of the data set is empty; give a path or a name on the hub")
    if isinstance(source, str) and (shipped := _SHIPPED.fullmatch(source)):
        source = str(_shipped_path(shipped["package"], shipped["inside"]))
    try:
        path = Path(source).expanduser()
        is_folder, is_file = path.is_dir(), path.is_file()
    except (OSError, RuntimeError) as error:  # a name that is too long, a home folder of nobody
        raise DatasetError(f"{str(source)!r:.200} is no path: {error}") from error
    if is_folder:
        return path.resolve()
    if is_file:
        if text_kind(path) or binary_kind(path):
            return path.resolve()
        raise DatasetError(f"{str(source)!r} has an ending that is not known; known are: {', '.join(known)}")
    # A name on the hub has at most one slash and no ending of a file.
    if not isinstance(source, str) or text_kind(path) or binary_kind(path) or not _HUB_NAME.fullmatch(source):
        near = path.parent
        while not near.is_dir():
            near = near.parent
        there = sorted(entry.name for entry in near.iterdir())[:10]
        raise DatasetError(
            f"there is no file or folder {str(source)!r}, and it is no name of the hub. "
            f"In {str(near)!r} there is: {', '.join(there) or 'nothing'}"
        )
    return None


def _shipped_path(package: str, inside: str) -> Path:
    """Return where a file lies that an installed package ships."""
    found = importlib.util.find_spec(package)
    folders = list(found.submodule_search_locations or []) if found is not None else []
    if not folders:
        raise DatasetError(f"there is no package {package!r}, so that {package}:{inside} is nowhere")
    return Path(folders[0], inside)


def _stamp(path: Path) -> tuple[str, int, int, int]:
    found = path.stat()
    return path.name, found.st_ino, found.st_size, found.st_mtime_ns


def _split_and_part(split: str | None) -> tuple[str | None, tuple[str | None, str | None] | None]:
    if split is None:
        return None, None
    if not isinstance(split, str) or not split:
        raise ArgumentError(f"split must be the name of a split, as in 'train', or None, not {split!r}")
    match = _PART.fullmatch(split)
    # The hub's library can add splits up, and reads the parts of these itself.
    if match is None and "+" not in split and ("[" in split or "]" in split):
        raise ArgumentError(f"a part of a split is written as in 'train[:100]' or 'train[10%:20%]', not {split!r}")
    return (split, None) if match is None else (match["split"] or None, (match["start"], match["stop"]))


def _selected(
    rows: Sequence[Row],
    part: tuple[str | None, str | None] | None,
    keep: Callable[[Row], Any] | None,
    source: RowSource,
) -> Rows:
    total = len(rows)
    among = range(total)
    if part is not None:
        among = among[slice(_bound(part[0], total), _bound(part[1], total))]
    if keep is None:
        return SelectedRows(rows, among)
    chosen = array("q", (index for index in among if call_on_row(keep, rows[index], index, "row_filter")))
    if not chosen and among:
        where = f" of {str(source)!r}" if isinstance(source, str | os.PathLike) else ""
        raise DatasetError(f"row_filter leaves none of the {len(among)} rows{where}")
    return SelectedRows(rows, chosen)


def _bound(text: str | None, total: int) -> int | None:
    if text is None:
        return None
    return round(int(text[:-1]) * total / 100) if text.endswith("%") else int(text)


def _function(given: RowFunction | None, what: str) -> Callable[[Row], Any] | None:
    if given is None or callable(given):
        return given
    if not isinstance(given, str) or ":" not in given:
        raise ArgumentError(f"{what} must be a function or 'package.module:function', not {given!r}")
    return load_entry_point(given, what)


class _KeyLock:
    """A lock that can be held weakly."""

    def __init__(self) -> None:
        self.lock = threading.Lock()


# Loading is guarded by a lock of its own for each source, so that a long download holds up nothing else.
_guard = threading.Lock()
_locks: WeakValueDictionary[Hashable, _KeyLock] = WeakValueDictionary()
_living: WeakValueDictionary[Hashable, Rows] = WeakValueDictionary()
_recent: OrderedDict[Hashable, Rows] = OrderedDict()
_refused: dict[Hashable, tuple[float, DatasetError]] = {}


def _shared(key: Hashable, load: Callable[[], Rows], *, lasting: bool = True) -> Rows:
    """Return rows that were loaded before, or load them.

    Args:
        key: What they are.
        load: Loads them.
        lasting: Whether a few of them outlive their environments, for those that are made next.
    """
    try:
        with _guard:
            own = _locks.setdefault(key, _KeyLock())
    except TypeError:  # a filter that has no hash
        return load()
    with own.lock:
        rows = _living.get(key)
        if rows is None:
            rows = _living[key] = load()
        if lasting:
            with _guard:
                _recent[key] = rows
                _recent.move_to_end(key)
                while len(_recent) > _KEPT:
                    _recent.popitem(last=False)
    return rows


def _from_hub(key: Hashable, load: Callable[[], Rows]) -> Rows:
    """Load from the hub, but not again right after it failed: offline, one attempt takes half a minute."""
    failed_at, error = _refused.get(key, (float("-inf"), None))
    if error is not None and time.monotonic() - failed_at < _HUB_PAUSE_S:
        raise DatasetError(str(error)) from error
    try:
        return load()
    except DatasetError as error:
        _refused[key] = (time.monotonic(), error.with_traceback(None))
        raise
