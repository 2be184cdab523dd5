"""Find data sets on this machine, and read rows of JSON and CSV without another package."""

from __future__ import annotations

import codecs
import csv
import gzip
import importlib.util
import io
import json
import re
import zlib
from pathlib import Path
from typing import IO, Any, cast

from gem_core.data.rows import Rows
from gem_core.errors import DatasetError

TEXT_ENDINGS = (".jsonl", ".ndjson", ".json", ".csv", ".tsv")
"""Endings of the files that ``read_text`` reads.

``datasets`` reads them too, but its parser of JSON ends the whole process on brackets that are nested 100,000 deep,
and that of CSV makes the number 7 of an answer 007, and nothing of NA.
"""

KNOWN_ENDINGS = (*TEXT_ENDINGS, ".parquet", ".arrow")
"""Endings of the files that a data set may be."""

_HUB_NAME = re.compile(r"[\w.-]+(/[\w.-]+)?", re.ASCII)
_SHIPPED = re.compile(r"(?P<package>[A-Za-z_]\w*):(?P<inside>[\w-][\w./-]*)", re.ASCII)


def local_path(source: str | Path) -> Path | None:
    """Return where a data set is on this machine, or None for a name on the hub.

    Raises:
        DatasetError: It is neither; the message names what is there instead.
    """
    if not str(source):
        raise DatasetError("the name of the data set is empty; give a path or a name on the hub")
    if isinstance(source, str) and (shipped := _SHIPPED.fullmatch(source)):
        source = _shipped_path(shipped["package"], shipped["inside"])
    try:
        path = Path(source).expanduser()
        is_folder, is_file = path.is_dir(), path.is_file()
    except (OSError, RuntimeError) as error:  # a name that is too long, a home folder that does not exist
        raise DatasetError(f"{str(source)!r:.200} is no path: {error}") from error
    is_known = ending(path) in KNOWN_ENDINGS
    if is_folder or (is_file and is_known):
        return path.resolve()
    if is_file:
        known = ", ".join(KNOWN_ENDINGS)
        raise DatasetError(f"{str(source)!r} has an ending that is not known; known are: {known}")
    if isinstance(source, str) and _HUB_NAME.fullmatch(source) and not is_known:
        return None
    near = next(folder for folder in path.absolute().parents if folder.is_dir())
    there = sorted(entry.name for entry in near.iterdir())[:10]
    raise DatasetError(
        f"there is no file or folder {str(source)!r}, and it is no name of the hub. "
        f"In {str(near)!r} there is: {', '.join(there) or 'nothing'}"
    )


def _shipped_path(package: str, inside: str) -> Path:
    """Return the path of a file that an installed package ships, without importing the package."""
    found = importlib.util.find_spec(package)
    folders = list(found.submodule_search_locations or []) if found is not None else []
    if not folders:
        raise DatasetError(f"there is no package {package!r}, so that {package}:{inside} is nowhere")
    return Path(folders[0], inside)


def ending(path: Path) -> str:
    """Return the ending that tells the format of a file, without ``.gz``."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def stamp(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Return a value that changes whenever a file, or one in a folder, changes."""
    files = [(str(file), file.stat()) for file in sorted([path, *path.rglob("*")])]
    return tuple((name, status.st_size, status.st_mtime_ns) for name, status in files)


def read_text(path: Path) -> Rows:
    """Return the rows of a file: lines of JSON objects, one list of objects, or CSV, whose values are all text.

    Raises:
        DatasetError: The file cannot be read, or is garbled; the message names the line.
    """
    try:
        with cast("IO[bytes]", gzip.open(path)) if path.suffix.lower() == ".gz" else path.open("rb") as file:
            return _csv_rows(file, path) if ending(path) in (".csv", ".tsv") else _json_rows(list(file), path)
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"{path} cannot be read: {error}") from error


def _csv_rows(file: IO[bytes], path: Path) -> Rows:
    limit = csv.field_size_limit(2**31 - 1)  # by default 131,072 characters, which a document exceeds
    with io.TextIOWrapper(file, "utf-8-sig", newline="") as text:
        reader = csv.DictReader(text, restval="", delimiter="\t" if ending(path) == ".tsv" else ",", strict=True)
        rows: list[dict[str | Any, Any]] = []
        try:
            names = [name for name in reader.fieldnames or () if name]
            if len(set(names)) < len(names):
                raise csv.Error("two columns have one name")
            for row in reader:
                if any(row.pop(None, [])):
                    raise csv.Error("it has more values than there are columns")
                row.pop("", None)  # an index that pandas wrote
                rows.append(row)
        except (csv.Error, UnicodeDecodeError) as error:
            raise DatasetError(f"{path}, line {reader.reader.line_num}: {error}") from error
        finally:
            csv.field_size_limit(limit)
    return Rows(rows, dict)


def _json_rows(lines: list[bytes], path: Path) -> Rows:
    """Return the rows of JSON. Lines are checked here, kept as bytes, and parsed again when their row is asked for."""
    if lines:
        lines[0] = lines[0].removeprefix(codecs.BOM_UTF8)
    lines = [line if line.strip() else b"" for line in lines]
    if next(filter(None, lines), b"").lstrip().startswith(b"["):
        rows = _parsed(b"".join(lines), str(path))
        for index, row in enumerate(rows):
            _check_object(row, f"{path}, row {index}")
        return Rows(rows, dict)
    for number, line in enumerate(lines, 1):
        if line:
            where = f"{path}, line {number}"
            _check_object(_parsed(line, where), where)
    return Rows([line for line in lines if line], json.loads)


def _parsed(text: bytes, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # brackets may be nested thousands deep
        shown = text[:60].decode("utf-8", "replace").strip()
        raise DatasetError(f"{where} is not JSON ({error}): {shown!r}") from error


def _check_object(row: Any, where: str) -> None:
    if not isinstance(row, dict):
        raise DatasetError(f'{where}: a row must be an object, as in {{"question": …}}, and this is: {row!r:.60}')
