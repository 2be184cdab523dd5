"""Data sets that the package ``datasets`` loads: the hub, folders, and files of Parquet and Arrow."""

from __future__ import annotations

import glob
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gem_core.data.files import ending
from gem_core.data.rows import Rows
from gem_core.errors import DatasetError, MissingRequirementError
from gem_core.registry.plugins import one_line
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
    try:
        if isinstance(source, Path) and source.is_file():
            loaded = datasets.load_dataset(ending(source)[1:], data_files=glob.escape(name))
        elif os.path.isfile(f"{name}/state.json") or os.path.isfile(f"{name}/dataset_dict.json"):
            loaded = datasets.load_from_disk(name)
        else:
            # Only the library knows what a sum of splits is, as in "train+test".
            total = split if split is not None and "+" in split else None
            loaded = datasets.load_dataset(name, config, split=total, revision=revision)
    except datasets.exceptions.DatasetNotFoundError as error:
        raise DatasetError(
            f"no data set {name!r} on the hub, or it is private: "
            f"check the name, or log in with 'hf auth login' ({one_line(error)})"
        ) from error
    except ConnectionError as error:
        raise DatasetError(
            f"the data set {name!r} is not in the cache, and the hub does not answer ({one_line(error)}); "
            "go online once, or give the path of a local copy as dataset_name"
        ) from error
    except Exception as error:  # each of a dozen file readers fails with exceptions of its own
        subset = f" (config {config!r})" if config else ""
        # The files of a folder may be data sets of their own, with other columns.
        files = sorted(path.name for path in Path(source).iterdir() if path.is_file()) if os.path.isdir(name) else []
        hint = f". If its files are data sets of their own, give one of them: {', '.join(files[:10])}" if files else ""
        cause = one_line(error.__cause__ or error)
        raise DatasetError(f"the data set {name!r}{subset} cannot be loaded: {cause}{hint}") from error
    return dataset_rows(one_split(loaded, repr(name), split))


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
