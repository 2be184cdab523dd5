"""Rows that the library ``datasets`` loads: the hub, folders, Parquet and Arrow; and cheap access to them."""

from __future__ import annotations

import os
import socket
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gem_core.data.views import Row, Rows
from gem_core.errors import DatasetError, MissingRequirementError
from gem_core.suggestions import did_you_mean

_NO_TELEMETRY = {"HF_HUB_DISABLE_TELEMETRY": "1", "HF_UPDATE_DOWNLOAD_COUNTS": "0"}
_BUILDERS = {".parquet": "parquet", ".arrow": "arrow"}


def binary_kind(path: Path) -> str | None:
    """Return what builds the rows of a file by its ending, or None."""
    return _BUILDERS.get(path.suffix.lower())


def is_dataset(rows: object) -> bool:
    """Tell whether something is a ``datasets.Dataset``, without importing that library."""
    return any(
        f"{base.__module__}.{base.__qualname__}" == "datasets.arrow_dataset.Dataset" for base in type(rows).__mro__
    )


def load_dataset_rows(source: str | Path, *, split: str | None, config: str | None, revision: str | None) -> Rows:
    """Return the rows of a data set that ``datasets`` loads.

    Args:
        source: Name on the hub, or the path of a folder, a Parquet or an Arrow file.
        split: Which split; None where there is but one.
        config: Which subset.
        revision: Version on the hub: a branch, a tag or a commit.

    Raises:
        MissingRequirementError: The library is not installed.
        DatasetError: There is no such data set, subset or split, it cannot be reached, or it is garbled.
    """
    library = _library(source)
    with _quiet(library), _explained(library, source, config):
        if isinstance(source, str):
            if _hub_has_an_address(library):
                loaded = library.load_dataset(source, config, split=split, revision=revision)
            else:
                loaded = _from_cache(source, config).as_dataset(split)
        elif source.is_file():
            loaded = library.load_dataset(binary_kind(source), data_files=os.fspath(source))
        elif (source / "state.json").exists() or (source / "dataset_dict.json").exists():
            loaded = library.load_from_disk(os.fspath(source))
        else:
            loaded = library.load_dataset(os.fspath(source), config)
    return ArrowRows(one_split(loaded, repr(os.fspath(source)), split, saved=isinstance(source, Path)))


class ArrowRows(Rows):
    """The rows of a ``datasets.Dataset``, of which only the columns that are read are converted.

    Args:
        dataset: The data set; its table stays where it is, most often mapped from a file.
    """

    def __init__(self, dataset: Any) -> None:
        from datasets.features.features import require_decoding  # type: ignore[import-untyped]

        self.dataset = dataset
        # With a format of the user's (a transform, tensors) the library itself must answer.
        self._plain = dataset.format["type"] is None
        self._columns = {name: dataset.data.column(name) for name in dataset.column_names} if self._plain else {}
        features = dataset.features
        self._decoders = {
            name: type(features)({name: kind}) for name, kind in features.items() if require_decoding(kind)
        }
        # Where rows were selected or shuffled: the place in the table of each.
        chosen = getattr(dataset, "_indices", None)
        self._places = None if chosen is None else chosen.column(0)

    def __len__(self) -> int:
        return len(self.dataset)

    def row(self, index: int) -> Row:
        """Return a row; each of its columns is read when it is asked for."""
        if not self._plain:
            row: Row = self.dataset[index]
            return row
        return ArrowRow(self, index if self._places is None else self._places[index].as_py())

    def __reduce__(self) -> tuple[Any, ...]:
        return ArrowRows, (self.dataset,)


class ArrowRow(Mapping[str, Any]):
    """One row of a table.

    Args:
        rows: Where it stands.
        place: Its place in the table.
    """

    __slots__ = ("_place", "_rows")

    def __init__(self, rows: ArrowRows, place: int) -> None:
        self._rows, self._place = rows, place

    def __getitem__(self, name: str) -> Any:
        value = self._rows._columns[name][self._place].as_py()
        decoder = self._rows._decoders.get(name)
        return value if decoder is None else decoder.decode_example({name: value})[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows._columns)

    def __len__(self) -> int:
        return len(self._rows._columns)

    def __contains__(self, name: object) -> bool:
        return name in self._rows._columns

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


def _library(source: str | Path) -> Any:
    # Read once, when the library is imported.
    added = {name: value for name, value in _NO_TELEMETRY.items() if name not in os.environ}
    os.environ.update(added)
    try:
        import datasets  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        if error.name != "datasets":
            raise
        raise MissingRequirementError(
            f"loading {os.fspath(source)!r} needs the package datasets: pip install 'gem-core[datasets]'"
        ) from error
    finally:
        for name in added:
            os.environ.pop(name, None)
    return datasets


@contextmanager
def _quiet(library: Any) -> Iterator[None]:
    """Show no progress bars meanwhile; ours belong to the command that runs."""
    if library.utils.are_progress_bars_disabled():
        yield
        return
    library.disable_progress_bars()
    try:
        yield
    finally:
        library.enable_progress_bars()


def _hub_has_an_address(library: Any) -> bool:
    """Tell whether the hub's name can be looked up; without one, the library would try for half a minute."""
    host = urllib.parse.urlsplit(library.config.HF_ENDPOINT).hostname or ""
    try:
        if not urllib.request.getproxies():  # a proxy looks names up itself
            socket.getaddrinfo(host, None)
    except OSError:
        return False
    return True


def _from_cache(source: str, config: str | None) -> Any:
    """Return the builder of a data set in the cache, as the library does by itself in its offline mode.

    To switch that mode on would take every other thread offline too.

    Raises:
        ConnectionError: It is not there.
    """
    from datasets.packaged_modules.cache.cache import Cache  # type: ignore[import-untyped]

    name = source.rpartition("/")[2]
    try:
        return Cache(dataset_name=name, repo_id=source, config_name=config, version="auto", hash="auto")
    except ValueError as error:
        if not str(error).startswith("Couldn't find cache"):
            raise
        raise ConnectionError(str(error)) from error


@contextmanager
def _explained(library: Any, source: str | Path, config: str | None) -> Iterator[None]:
    """Turn what the library raises into one line that says what to do."""
    name = os.fspath(source)
    subset = f" (config {config!r})" if config else ""
    try:
        yield
    except library.exceptions.DatasetNotFoundError as error:
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


def one_split(loaded: Any, name: str, split: str | None, *, saved: bool = False) -> Any:
    """Return the one data set that is meant.

    Args:
        loaded: A data set, or several by the names of their splits.
        name: What it is called in errors.
        split: Which split; None where there is but one.
        saved: Whether ``loaded``, where it is but one, is one split that was chosen by nobody yet.

    Raises:
        DatasetError: There is no such split, or several and none was chosen.
    """
    if not isinstance(loaded, Mapping):
        own = str(loaded.split or "train")
        if saved and split not in (None, own):
            raise DatasetError(f"no split {split!r} in {name}. Splits: {own!r}")
        return loaded
    names = ", ".join(map(repr, loaded))
    if split is None and len(loaded) == 1:
        return next(iter(loaded.values()))
    if split is None:
        raise DatasetError(f"{name} has several splits; choose one with split=: {names}")
    if split not in loaded:
        raise DatasetError(f"no split {split!r} in {name}.{did_you_mean(split, loaded)} Splits: {names}")
    return loaded[split]
