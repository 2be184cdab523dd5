"""Data sets that the package ``datasets`` loads: the hub, folders, and files of CSV, Parquet and Arrow."""

from __future__ import annotations

import csv
import glob
import io
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gem_core.data.files import ending, opened
from gem_core.data.rows import Rows
from gem_core.errors import DatasetError, MissingRequirementError
from gem_core.suggestions import did_you_mean


def load_with_datasets(source: str | Path, *, split: str | None, config: str | None, revision: str | None) -> Rows:
    """Return the rows of a data set that ``datasets`` loads; they stay in its cache, mapped into memory.

    Args:
        source: Name on the hub, or the path of a folder or a file.
        split: Which split; None if there is but one.
        config: Which subset.
        revision: Version on the hub: a branch, a tag or a commit.

    Raises:
        MissingRequirementError: The package is not installed.
        DatasetError: There is no such data set, subset or split, it cannot be reached, or it is garbled.
    """
    name = os.fspath(source)
    try:
        import datasets  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        if error.name != "datasets":
            raise
        raise MissingRequirementError(
            f"loading {name!r} needs the package datasets: pip install 'gem-core[datasets]'"
        ) from error
    with _explain_errors(datasets, source, config):
        if isinstance(source, Path) and source.is_file():
            loaded = _load_file(datasets, source)
        elif os.path.isfile(f"{name}/state.json") or os.path.isfile(f"{name}/dataset_dict.json"):
            loaded = datasets.load_from_disk(name)
        else:
            # Only the library knows what a sum of splits is, as in "train+test".
            total = split if split is not None and "+" in split else None
            loaded = datasets.load_dataset(name, config, split=total, revision=revision)
    return dataset_rows(one_split(loaded, repr(name), split))


def _load_file(datasets: Any, path: Path) -> Any:
    kind, file_name = ending(path), glob.escape(str(path))
    if kind not in (".csv", ".tsv"):
        return datasets.load_dataset(kind[1:], data_files=file_name)
    separator = "\t" if kind == ".tsv" else ","
    with opened(path) as file, io.TextIOWrapper(file, "utf-8-sig", newline="") as text:
        header = next(csv.reader(text, delimiter=separator), [])
    # Every value is the text in the file: an answer 007, 1.50 or NA would become the number 7, 1.5, or nothing, and
    # where a row has more fields than the header, each would move to the column before its own.
    columns = datasets.Features({column: datasets.Value("string") for column in header if column})
    as_written = {"sep": separator, "features": columns, "keep_default_na": False, "index_col": False}
    return datasets.load_dataset("csv", data_files=file_name, **as_written)


def dataset_rows(dataset: Any) -> Rows:
    """Return the rows of a ``datasets.Dataset``, of which only the columns that are read are converted."""
    if dataset.format["type"] is None:  # else the user chose a format, or a transform
        dataset = dataset.with_format("python", lazy=True)
    return Rows(range(len(dataset)), dataset.__getitem__)


def is_from_datasets(rows: object, kind: str) -> bool:
    """Tell whether something is of a class of ``datasets``, which cannot be where that package was not imported."""
    return isinstance(rows, getattr(sys.modules.get("datasets"), kind, ()))


def one_split(loaded: Any, name: str, split: str | None) -> Any:
    """Return the data set of a split.

    Args:
        loaded: A data set, or several by the names of their splits.
        name: What it is called in errors.
        split: Which split; None if there is but one.

    Raises:
        DatasetError: There is no such split, or several and none was chosen.
    """
    if not isinstance(loaded, Mapping):
        loaded = {str(loaded.split or "train"): loaded}
    names = ", ".join(map(repr, loaded))
    if split is None and len(loaded) > 1:
        raise DatasetError(f"{name} has several splits; choose one with split=: {names}")
    if split is None:
        return next(iter(loaded.values()))
    if split not in loaded:
        raise DatasetError(f"no split {split!r} in {name}.{did_you_mean(split, loaded)} Splits: {names}")
    return loaded[split]


@contextmanager
def _explain_errors(datasets: Any, source: str | Path, config: str | None) -> Iterator[None]:
    """Turn exceptions of the library into an error with one line that says what to do."""
    name = os.fspath(source)
    try:
        yield
    except datasets.exceptions.DatasetNotFoundError as error:
        raise DatasetError(
            f"no data set {name!r} on the hub, or it is private: "
            f"check the name, or log in with 'hf auth login' ({_line(error)})"
        ) from error
    except ConnectionError as error:
        raise DatasetError(
            f"the data set {name!r} is not in the cache, and the hub does not answer ({_line(error)}); "
            "go online once, or give the path of a local copy as dataset_name"
        ) from error
    # Each of a dozen file readers fails with exceptions of its own.
    except Exception as error:
        subset = f" (config {config!r})" if config else ""
        cause = error.__cause__ or error
        raise DatasetError(
            f"the data set {name!r}{subset} cannot be loaded: {_line(cause)}{_files_in(source)}"
        ) from error


def _files_in(source: str | Path) -> str:
    """Return a hint for a folder, whose files may be data sets of their own with other columns."""
    files = sorted(path.name for path in Path(source).iterdir() if path.is_file()) if os.path.isdir(source) else []
    return f". If its files are data sets of their own, give one of them: {', '.join(files[:10])}" if files else ""


def _line(error: BaseException) -> str:
    """Return an error in one line, with its type where the text alone says little."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:300]}" if text else type(error).__name__
