"""Rows of text files: JSON, JSON lines and CSV, read with the standard library alone."""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import zlib
from array import array
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from gem_core.data.views import Row, Rows
from gem_core.errors import DatasetError

TEXT_KINDS = (".jsonl", ".ndjson", ".json", ".csv", ".tsv")
"""Endings of the files that are read here; each may be followed by ``.gz``."""

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
# RecursionError: brackets nested thousands deep.
_GARBLED = (ValueError, RecursionError)


class _NoObjectError(ValueError):
    """What was read is JSON, but no object."""


def text_kind(path: Path) -> str | None:
    """Return the ending that says what a file holds, or None where it is no text file."""
    name = path.name.lower().removesuffix(".gz")
    return next((kind for kind in TEXT_KINDS if name.endswith(kind)), None)


def read_text_rows(path: Path) -> Rows:
    """Return the rows of a text file. Each has been parsed once, so that a garbled one shows now.

    Raises:
        DatasetError: The file cannot be read, or is garbled; the message names the line.
    """
    kind = text_kind(path)
    try:
        if kind in (".jsonl", ".ndjson"):
            return JsonLines(path, _unpacked(path) if _is_packed(path) else None)
        content = _unpacked(path) if _is_packed(path) else path.read_bytes()
    except (OSError, EOFError, zlib.error) as error:
        raise DatasetError(f"{path} cannot be read: {error}") from error
    return _json_rows(path, content) if kind == ".json" else _csv_rows(path, content, "\t" if kind == ".tsv" else ",")


class JsonLines(Rows):
    """Lines of JSON, each read from its file and parsed when its row is asked for.

    Only where lines begin is kept in memory, and processes on one file share the system's cache of it. The file stays
    open, so one that is put into its place changes nothing; one that is overwritten is an error, and no crash.

    Args:
        path: The file.
        content: Its lines, where they are in memory already.

    Raises:
        DatasetError: A line is not a JSON object.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, content: bytes | None = None) -> None:
        self._path = path
        self._content = content
        self._starts, self._lengths = array("q"), array("q")
        self._descriptor = -1
        if content is not None:
            self._find_lines(io.BytesIO(content))
            return
        self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        with open(self._descriptor, "rb", closefd=False) as lines:
            self._find_lines(lines)

    def __del__(self, close: Callable[[int], None] = os.close) -> None:
        """Close the file; with what is kept here, since modules are gone when the interpreter ends."""
        if getattr(self, "_descriptor", -1) >= 0:
            close(self._descriptor)
            self._descriptor = -1

    def __len__(self) -> int:
        return len(self._starts)

    def row(self, index: int) -> Row:
        """Return a row.

        Raises:
            DatasetError: The file was overwritten.
        """
        start, length = self._starts[index], self._lengths[index]
        try:
            if self._content is not None:
                return _object(self._content[start : start + length])
            return _object(os.pread(self._descriptor, length, start))
        except (*_GARBLED, OSError) as error:
            raise DatasetError(f"{self._path} was overwritten while it was in use: row {index} is gone") from error

    def __reduce__(self) -> tuple[Any, ...]:
        return JsonLines, (self._path, self._content)

    def _find_lines(self, lines: Iterable[bytes]) -> None:
        start = 0
        for number, line in enumerate(lines, 1):
            mark = len(_BYTE_ORDER_MARK) if number == 1 and line.startswith(_BYTE_ORDER_MARK) else 0
            if line[mark:].strip():
                try:
                    _object(line[mark:])
                except _NoObjectError as error:
                    raise DatasetError(f"{self._path}, line {number}: {error}") from error
                except _GARBLED as error:
                    shown = line[mark : mark + 60].decode("utf-8", "replace").strip()
                    raise DatasetError(f"{self._path}, line {number} is not JSON ({error}): {shown!r}") from error
                self._starts.append(start + mark)
                self._lengths.append(len(line) - mark)
            start += len(line)


class ListedRows(Rows):
    """Rows in memory, of one file.

    Args:
        rows: The rows.
    """

    def __init__(self, rows: list[dict[str, Any]]) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return len(self._rows)

    def row(self, index: int) -> Row:
        """Return a row."""
        return self._rows[index]


def _object(line: bytes) -> dict[str, Any]:
    value = json.loads(line.decode("utf-8"))
    if not isinstance(value, dict):
        raise _NoObjectError(f'a row must be an object, as in {{"question": …}}, and this is: {value!r:.60}')
    return value


def _json_rows(path: Path, content: bytes) -> Rows:
    try:
        value = json.loads(content.decode("utf-8-sig"))
    except _GARBLED as error:
        if isinstance(error, json.JSONDecodeError) and error.msg == "Extra data":
            return JsonLines(path, content)  # lines, though the file's name says otherwise
        raise DatasetError(f"{path} is not JSON: {error}") from error
    if not isinstance(value, list):
        keys = f", with the keys {', '.join(map(repr, list(value)[:10]))}" if isinstance(value, dict) else ""
        raise DatasetError(f"{path} must hold a list of objects, and holds one {type(value).__name__}{keys}")
    for index, row in enumerate(value):
        if not isinstance(row, dict):
            raise DatasetError(f"{path}, row {index}: a row must be an object, and this is: {row!r:.60}")
    return ListedRows(value)


def _csv_rows(path: Path, content: bytes, delimiter: str) -> Rows:
    rows = []
    try:
        reader = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""), delimiter=delimiter, strict=True)
        header = next(reader, [])
        if len(set(header)) < len(header):
            raise DatasetError(f"{path} has a column twice: {', '.join(map(repr, header))}")
        for fields in reader:
            if fields and len(fields) != len(header):
                raise DatasetError(
                    f"{path}, line {reader.line_num}: {len(fields)} fields, and the header has {len(header)}"
                )
            if fields:
                rows.append(dict(zip(header, fields, strict=True)))
    except (csv.Error, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} is not CSV in UTF-8: {error}") from error
    return ListedRows(rows)


def _is_packed(path: Path) -> bool:
    return path.name.lower().endswith(".gz")


def _unpacked(path: Path) -> bytes:
    with gzip.open(path) as file:
        return file.read()
