"""A BM25 index on disk: searched where it lies, through the memory map, by any number of threads and processes.

Scoring is done by ``bm25s``. Words and passages lie beside it in files of our own, so that opening an index reads
only the ends of its files and costs no memory, however large it is.
"""

from __future__ import annotations

import json
import mmap
import zlib
from pathlib import Path
from typing import Any

import bm25s  # type: ignore[import-untyped] # it ships no types
import numpy as np
from numpy.typing import NDArray

from gem_core.errors import DatasetError
from gem_tools.search.passages import Passage
from gem_tools.search.words import query_words

FORMAT = 2
"""Goes up whenever an index that was built by earlier code would be searched wrongly."""

META = "meta.json"
MAX_QUERY_WORDS = 64

_PROVED_BYTES = 65_536
"""Of each file so much is proved at both ends whenever it is opened; to read all of it would take seconds."""


class Blob:
    """Many byte strings in one file, with their offsets in another.

    Args:
        folder: Where both lie.
        name: Of the files, without ending.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._offsets: NDArray[np.int64] = np.asarray(np.load(folder / f"{name}.offsets.npy", mmap_mode="r"))
        with (folder / f"{name}.bin").open("rb") as stream:
            size = stream.seek(0, 2)
            # An empty file cannot be mapped.
            self._bytes: mmap.mmap | bytes = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) if size else b""

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def __getitem__(self, number: int) -> bytes:
        return self._bytes[int(self._offsets[number]) : int(self._offsets[number + 1])]

    def find(self, wanted: bytes) -> int | None:
        """Return the place of a string in a blob that is sorted; None if it is not there."""
        low, high = 0, len(self)
        while low < high:
            middle = (low + high) // 2
            if self[middle] < wanted:
                low = middle + 1
            else:
                high = middle
        return low if low < len(self) and self[low] == wanted else None


class Index:
    """A corpus that can be searched. Nothing in it changes, so any number of threads may search at once.

    Args:
        folder: Where it was built.

    Raises:
        DatasetError: What lies there is no whole index of this version.
    """

    def __init__(self, folder: Path) -> None:
        _check(folder)
        try:
            self._open(folder)
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise DatasetError(f"the index in {folder.name!r} is damaged ({type(error).__name__})") from error

    def _open(self, folder: Path) -> None:
        self._words = Blob(folder, "words")
        self._ids: NDArray[np.int32] = np.asarray(np.load(folder / "words.ids.npy", mmap_mode="r"))
        self._passages = Blob(folder, "passages")
        self._scorer = bm25s.BM25.load(folder, load_vocab=False, mmap=True, show_progress=False)
        scores = self._scorer.scores
        # Plain views of the maps: slicing numpy's memmap objects costs more than the search for a rare word.
        for name in ("data", "indices", "indptr"):
            scores[name] = np.asarray(scores[name])

    def __len__(self) -> int:
        return len(self._passages)

    def search(self, query: str, top_k: int) -> list[Passage]:
        """Return the passages that fit best, the best first; of equals, the one that stands first in the corpus."""
        found = (self._words.find(word.encode()) for word in query_words(query, MAX_QUERY_WORDS))
        ids = [int(self._ids[place]) for place in found if place is not None]
        if not ids:
            return []
        scores = self._scorer.get_scores_from_ids(ids)
        return [self._passage(int(number), float(scores[number])) for number in best(scores, top_k)]

    def _passage(self, number: int, score: float) -> Passage:
        name, title, text = json.loads(self._passages[number])
        return Passage(name, title, text, score)


def proof(file: Path) -> list[int]:
    """Return what tells whether a file is as it was written: its size, and a checksum of both its ends.

    A machine that crashes may leave files of the right size, and zeros in them.
    """
    with file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        checksum = zlib.crc32(stream.read(_PROVED_BYTES))
        stream.seek(max(0, size - _PROVED_BYTES))
        return [size, zlib.crc32(stream.read(_PROVED_BYTES), checksum)]


def _check(folder: Path) -> None:
    try:
        meta: Any = json.loads((folder / META).read_text(encoding="utf-8"))
        whole = meta["format"] == FORMAT and all(
            proof(folder / name) == expected for name, expected in meta["files"].items()
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise DatasetError(f"there is no index in {folder.name!r} ({type(error).__name__})") from None
    if not whole:
        raise DatasetError(f"the index in {folder.name!r} is damaged or of another version")


def best(scores: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Return the places of the highest scores above zero, highest first, of equals the first.

    Scores: float32, (num_passages,). Most are zero, on which NumPy's selection is slow (8 ms for 100,000): they are
    sorted out first.
    """
    places = np.flatnonzero(scores > 0)
    values = scores[places]
    if len(places) > count:
        threshold = np.partition(values, len(values) - count)[len(values) - count]
        above = np.flatnonzero(values > threshold)
        # Of equals only as many as there is room for: in a corpus of copies all are equal.
        equal = np.flatnonzero(values == threshold)[: count - len(above)]
        chosen = np.concatenate([above, equal])
        places, values = places[chosen], values[chosen]
    return places[np.lexsort((places, -values))]
