"""A BM25 index on disk, built once for each corpus and searched through the memory map by any number of processes.

``bm25s`` scores; the passages lie in a file of their own beside its files.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import os
import shutil
import weakref
from array import array
from collections import defaultdict
from pathlib import Path

import bm25s  # type: ignore[import-untyped] # it ships no types
import numpy as np
from numpy.typing import NDArray

from gem_core.errors import ArgumentError, DatasetError
from gem_core.progress import Progress
from gem_tools.search.corpus import Corpus, find_corpus
from gem_tools.search.passages import Passage
from gem_tools.search.words import query_words, singular, split_words

FORMAT = 4
"""Goes up when indices of earlier code would be searched wrongly."""

K1, B = 1.2, 0.75
"""Source: the defaults of Lucene's BM25Similarity."""

TITLE_WEIGHT = 2
"""How often a title counts, so that a passage about a subject comes before one that mentions it."""

_QUIET_BYTES = 2_000_000
"""A corpus up to this size is indexed without a bar of progress."""

_open: weakref.WeakValueDictionary[Path, Index] = weakref.WeakValueDictionary()
"""The indices of this process by folder, shared by all tools."""


class Index:
    """A corpus that can be searched, by any number of threads at once, in the folder where it was built.

    Raises:
        OSError: There is no index.
        ValueError: Its files are damaged.
    """

    def __init__(self, folder: Path) -> None:
        self._offsets: NDArray[np.int64] = np.load(folder / "offsets.npy", mmap_mode="r")
        self._passages = np.memmap(folder / "passages.bin", mode="r")
        if len(self._passages) != self._offsets[-1]:
            raise ValueError("passages.bin was cut")
        self._scorer = bm25s.BM25.load(folder, mmap=True, show_progress=False)

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def search(self, query: str, top_k: int) -> list[Passage]:
        """Return the passages that fit best, the best first; of equals, the one that stands first in the corpus."""
        scores = self._scorer.get_scores_from_ids(self._scorer.get_tokens_ids(query_words(query)))
        return [self._passage(int(number), float(scores[number])) for number in best(scores, top_k)]

    def _passage(self, number: int, score: float) -> Passage:
        name, title, text = json.loads(bytes(self._passages[self._offsets[number] : self._offsets[number + 1]]))
        return Passage(name, title, text, score)


def best(scores: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Return the places of the highest scores above zero, highest first, of equals the first.

    Scores: float32, (num_passages,). bm25s's own selection takes 8 ms for 100,000 and orders equals at random.
    """
    places = np.flatnonzero(scores > 0)
    values = scores[places]
    if len(places) > count:
        high = values >= np.partition(values, -count)[-count]
        places, values = places[high], values[high]
    return places[np.argsort(-values, kind="stable")[:count]]


def open_index(place: str | os.PathLike[str], cache_dir: str | os.PathLike[str] | None = None) -> Index:
    """Return the index of a corpus, built if there is none yet.

    Args:
        place: A file of JSON lines, a folder of text files, or ``"articles"``.
        cache_dir: Where indices are kept; by default ``gem/search`` in the user's cache folder.

    Raises:
        ArgumentError: There is no corpus, or the folder given for the cache cannot be used.
        DatasetError: The corpus cannot be read; the message names the line.
    """
    corpus = find_corpus(place)
    try:
        folder = _cache_folder(cache_dir) / f"{corpus.fingerprint()}.{FORMAT}"
        index = _open.get(folder)
        if index is None:
            index = _open[folder] = _opened(folder) or _built(corpus, folder)
        return index
    except OSError as error:
        raise DatasetError(f"the corpus {str(place)!r} cannot be indexed: {error}") from error


def _opened(folder: Path) -> Index | None:
    with contextlib.suppress(OSError, ValueError, EOFError):
        return Index(folder)
    return None


def _built(corpus: Corpus, folder: Path) -> Index:
    work = folder.with_name(f"{folder.name}.tmp")
    with folder.with_name(f"{folder.name}.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the others wait, and then find the index
        if index := _opened(folder):
            return index
        shutil.rmtree(work, ignore_errors=True)  # left by a process that was killed
        try:
            work.mkdir()
            _build(corpus, work)
            shutil.rmtree(folder, ignore_errors=True)  # damaged
            work.rename(folder)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    return Index(folder)


def _build(corpus: Corpus, folder: Path) -> None:
    """Write the index of a corpus into an empty folder.

    Raises:
        DatasetError: A line of the corpus is no passage, or there is none.
    """
    quiet = corpus.size <= _QUIET_BYTES
    vocabulary: defaultdict[str, int] = defaultdict()
    vocabulary.default_factory = vocabulary.__len__  # a new word gets the next number
    number = functools.cache(lambda word: vocabulary[singular(word)])
    documents: list[list[int]] = []
    offsets = array("q", [0])
    with (
        Progress(corpus.size // 1000, "reading the corpus", quiet=quiet, unit="kB") as progress,
        (folder / "passages.bin").open("wb") as stream,
    ):
        for passage in corpus.passages():
            row = json.dumps([passage.id, passage.title, passage.text], ensure_ascii=False)
            stream.write(row.encode())
            offsets.append(stream.tell())
            if len(offsets) % 1000 == 0:
                progress.advance(offsets[-1] // 1000)
            words = split_words(f"{(passage.title + ' ') * TITLE_WEIGHT}{passage.text}")
            documents.append([*map(number, words)])
    if not vocabulary:
        raise DatasetError(f"the corpus {corpus.path.name!r} holds no passage with a word in it")
    with Progress(None, f"indexing {len(documents)} passages", quiet=quiet):
        scorer = bm25s.BM25(k1=K1, b=B, method="lucene")
        scorer.index((documents, dict(vocabulary)), show_progress=False, create_empty_token=False)
        scorer.save(folder, show_progress=False)
    np.save(folder / "offsets.npy", np.frombuffer(offsets, dtype=np.int64))


def _cache_folder(cache_dir: str | os.PathLike[str] | None) -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    place = cache_dir or Path(base, "gem", "search")
    try:
        folder = Path(place).expanduser().resolve()
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    except (OSError, RuntimeError):  # a file is in the way, or the user has no home
        pass
    raise ArgumentError(f"the folder {str(place)!r} for indices cannot be written to; name another by cache_dir=…")
