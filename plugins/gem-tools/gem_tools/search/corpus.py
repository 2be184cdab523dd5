"""A corpus on disk: a file of JSON lines, or a folder of text files."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gem_core.errors import ArgumentError, DatasetError
from gem_tools.search.passages import Passage, printable

ARTICLES = "articles"
"""Name of the corpus that comes with the plugin."""

PASSAGE_CHARS = 1200
"""Longest passage, in characters, into which the files of a folder are cut."""

_TEXTS = (".txt", ".md", ".rst")
_FORM = '{"id": …, "title": …, "text": …}'


@dataclass(frozen=True)
class Corpus:
    """A file or folder, its files in the order in which they are read, and the bytes of them all."""

    path: Path
    files: tuple[Path, ...]
    size: int

    def passages(self) -> Iterator[Passage]:
        """Yield the passages in order.

        Raises:
            DatasetError: A line is no passage; the message names file and line.
        """
        if self.path.is_dir():
            for file in self.files:
                yield from _from_text(file, self.path)
            return
        with self.path.open("rb") as stream:
            for number, line in enumerate(stream, start=1):
                if line.strip():
                    yield _passage(line, f"{self.path.name}, line {number}", number)

    def fingerprint(self) -> str:
        """Return a hash that changes with the names, sizes and times of the files."""
        hashed = hashlib.blake2b(digest_size=20)
        for file in self.files:
            stat = file.stat()
            hashed.update(repr((os.fsencode(file), stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)).encode())
        return hashed.hexdigest()


def find_corpus(place: str | os.PathLike[str]) -> Corpus:
    """Return the corpus at a path, or the shipped one for the name ``"articles"``.

    Raises:
        ArgumentError: There is none; the message says what was expected.
    """
    if place == ARTICLES:
        place = Path(__file__).with_name("articles.jsonl")
    try:
        path = Path(place).expanduser().resolve()
    except (TypeError, ValueError, RuntimeError) as error:
        raise ArgumentError(f"{place!r} is no path of a corpus: {error}") from None
    try:
        files = tuple(_files_of(path)) if path.is_dir() else (path,)
        wrong = None
        if not path.exists():
            wrong = f"no corpus at {str(place)!r}"
        elif not files:
            wrong = f"the folder {str(place)!r} holds no text files"
        elif not path.is_dir() and not path.is_file():
            wrong = f"{str(place)!r} is neither a file nor a folder"
        if wrong is not None:
            expected = f"a file of lines {_FORM}, a folder of {', '.join(_TEXTS)} files, or {ARTICLES!r}"
            raise ArgumentError(f"{wrong}; expected {expected}")
        return Corpus(path, files, sum(file.stat().st_size for file in files))
    except OSError as error:
        of_it = f" ({error.filename!r})" if error.filename not in (None, str(path)) else ""
        raise ArgumentError(f"the corpus {str(place)!r} cannot be read: {error.strerror}{of_it}") from None


def _files_of(folder: Path) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise error  # os.walk would leave the folder out, and its texts would never be found

    for place, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            file = Path(place, name)
            # Reading a pipe would never end.
            if not name.startswith(".") and file.suffix.lower() in _TEXTS and file.is_file():
                yield file


def _passage(line: bytes, place: str, number: int) -> Passage:
    try:
        row = json.loads(line.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace"))
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{place} is no JSON ({error}); expected {_FORM}") from None
    if not isinstance(row, dict):
        raise DatasetError(f"{place} is a {type(row).__name__}, not an object; expected {_FORM}")
    title, text = row.get("title") or "", row.get("text")
    if text is None and isinstance(row.get("contents"), str):
        title, text = split_contents(row["contents"])
    if not isinstance(title, str) or not isinstance(text, str):
        raise DatasetError(f"{place} has no text in 'text' (or 'title' is none); expected {_FORM}")
    name = row.get("id", row.get("_id"))
    return Passage(printable(str(number if name is None else name)), printable(title), printable(text))


def split_contents(contents: str) -> tuple[str, str]:
    """Return title and text of ``contents`` in Search-R1's form: the title in quotes on the first line."""
    first, line_break, rest = contents.partition("\n")
    return (first.strip().strip('"'), rest) if line_break else ("", contents)


def _from_text(file: Path, folder: Path) -> Iterator[Passage]:
    name = printable(file.relative_to(folder).as_posix())
    title = printable(file.stem).replace("_", " ")
    pieces = _pieces(printable(file.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n")))
    for number, piece in enumerate(pieces, start=1):
        yield Passage(name if len(pieces) == 1 else f"{name}#{number}", title, piece)


def _pieces(text: str) -> list[str]:
    """Cut a text into passages, between paragraphs where that is possible, else between words."""
    pieces: list[str] = []
    for paragraph in filter(None, map(str.strip, text.split("\n\n"))):
        if pieces and len(pieces[-1]) + len(paragraph) + 2 <= PASSAGE_CHARS:
            pieces[-1] += f"\n\n{paragraph}"
            continue
        while len(paragraph) > PASSAGE_CHARS:
            end = max(paragraph.rfind(" ", 0, PASSAGE_CHARS), paragraph.rfind("\n", 0, PASSAGE_CHARS))
            end = end if end > PASSAGE_CHARS // 2 else PASSAGE_CHARS
            pieces.append(paragraph[:end].rstrip())
            paragraph = paragraph[end:].lstrip()
        if paragraph:
            pieces.append(paragraph)
    return pieces
