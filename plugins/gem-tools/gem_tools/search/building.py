"""Building an index, once for each content of a corpus, in a folder that all processes share."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import shutil
import tempfile
import threading
import time
import weakref
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bm25s  # type: ignore[import-untyped] # it ships no types
import numpy as np

from gem_core.errors import ArgumentError, DatasetError
from gem_core.progress import Progress
from gem_tools.search.corpus import Corpus, find_corpus
from gem_tools.search.index import FORMAT, META, Index, proof
from gem_tools.search.words import singular, split_words

K1, B = 1.2, 0.75
"""Source: the defaults of Lucene's BM25Similarity."""

TITLE_WEIGHT = 2
"""How often a title counts, so that what is about a subject comes before what mentions it."""

_SHOW_FROM_BYTES = 2_000_000
"""A smaller corpus is indexed before a progress bar could be read."""

_RACY_S = 2.0
"""A file that changed so lately might change again without another time stamp."""

logger = logging.getLogger("gem_tools")

_lock = threading.Lock()
_open: weakref.WeakValueDictionary[tuple[str, str], Index] = weakref.WeakValueDictionary()
"""The indices of this process, by cache folder and digest: every tool that searches the same corpus shares one."""


def open_index(place: str | os.PathLike[str], cache_dir: str | os.PathLike[str] | None = None) -> Index:
    """Return the index of a corpus, built if this content has not been indexed yet.

    Args:
        place: A file of JSON lines, a folder of text files, or ``"articles"``.
        cache_dir: Where indices are kept; by default ``gem/search`` in the user's cache folder.

    Raises:
        ArgumentError: There is no corpus, or the folder given for the cache cannot be used.
        DatasetError: The corpus cannot be read; the message names the line.
    """
    corpus = find_corpus(place)
    try:
        with _lock:
            folder = cache_folder(cache_dir)
            digest = _digest(corpus, folder)
            index = _open.get((str(folder), digest))
            if index is None:
                index = _opened(corpus, folder, digest)
                _open[str(folder), digest] = index
            return index
    except OSError as error:
        raise DatasetError(f"the corpus {str(place)!r} cannot be indexed: {error}") from error


def _opened(corpus: Corpus, folder: Path, digest: str) -> Index:
    target = folder / digest
    with contextlib.suppress(DatasetError):
        return Index(target)
    with _only_one_builds(folder / f"{digest}.lock"):
        with contextlib.suppress(DatasetError):  # another process has built it meanwhile
            return Index(target)
        for left_over in folder.glob(f"{digest}.tmp*"):  # of a process that was killed
            shutil.rmtree(left_over, ignore_errors=True)
        work = Path(tempfile.mkdtemp(prefix=f"{digest}.tmp", dir=folder))
        try:
            stamp = corpus.stamp()
            build(corpus, work)
            if corpus.stamp() != stamp or (corpus.size <= _SHOW_FROM_BYTES and corpus.digest() != digest):
                raise DatasetError(f"the corpus {corpus.path.name!r} was changed while it was indexed; try again")
            if target.exists():  # damaged, or of an earlier version
                shutil.rmtree(target)
            work.rename(target)
        except BaseException:
            shutil.rmtree(work, ignore_errors=True)
            raise
    return Index(target)


def build(corpus: Corpus, folder: Path) -> None:
    """Write the index of a corpus into an empty folder; the last file written says that it is whole.

    Raises:
        DatasetError: A line of the corpus is no passage, or there is none.
    """
    quiet = corpus.size < _SHOW_FROM_BYTES
    with Progress(corpus.size // 1000, "reading the corpus", quiet=quiet, unit="kB") as progress:
        tokens = _Tokens()
        with _BlobWriter(folder, "passages") as passages:
            for passage in corpus.passages(lambda done: progress.advance(done // 1000)):
                row = json.dumps([passage.id, passage.title, passage.text], ensure_ascii=False)
                passages.add(row.encode("utf-8", "replace"))
                tokens.add(f"{(passage.title + ' ') * TITLE_WEIGHT}{passage.text}")
    if not tokens.ids_of_words:
        raise DatasetError(f"the corpus {corpus.path.name!r} holds no passage with a word in it")
    _write_words(folder, tokens.ids_of_words)
    # bm25s reads all passages three times: to measure, to count, and to score them.
    with Progress(3 * len(tokens), "indexing", quiet=quiet, unit="passages, each three times") as progress:
        scorer = bm25s.BM25(k1=K1, b=B, method="lucene")
        scorer.index(_Shown(tokens, progress), show_progress=False, create_empty_token=False)
    # The words have a file of their own; bm25s would read all of them whenever an index is opened.
    scorer.vocab_dict = {}
    scorer.save(folder, show_progress=False)
    proofs = {file.name: proof(file) for file in sorted(folder.iterdir())}
    meta = {"format": FORMAT, "passages": len(tokens), "files": proofs}
    (folder / META).write_text(json.dumps(meta), encoding="utf-8")


class _Tokens:
    """The numbers of the words of all passages, one after the other, in four bytes each."""

    def __init__(self) -> None:
        self.ids_of_words: dict[str, int] = {}
        self._seen: dict[str, int] = {}
        self._ids = array("i")
        self._ends = array("q", [0])

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __iter__(self) -> Iterator[list[int]]:
        for start, end in zip(self._ends, self._ends[1:], strict=False):
            yield self._ids[start:end].tolist()

    def add(self, text: str) -> None:
        seen = self._seen
        for word in split_words(text):
            number = seen.get(word)
            if number is None:
                number = seen[word] = self.ids_of_words.setdefault(singular(word), len(self.ids_of_words))
            self._ids.append(number)
        self._ends.append(len(self._ids))


class _Shown:
    """What ``bm25s`` takes as a corpus: passages as lists of numbers, and the words. Shows how far it has read."""

    def __init__(self, tokens: _Tokens, progress: Progress) -> None:
        self.vocab = tokens.ids_of_words
        self.ids = self
        self._tokens, self._progress = tokens, progress
        self._done = 0

    def __len__(self) -> int:
        return len(self._tokens)

    def __iter__(self) -> Iterator[list[int]]:
        for ids in self._tokens:
            self._done += 1
            if self._done % 1000 == 0:
                self._progress.advance(self._done)
            yield ids


class _BlobWriter:
    """Writes what ``index.Blob`` reads."""

    def __init__(self, folder: Path, name: str) -> None:
        self._stream = (folder / f"{name}.bin").open("wb")
        self._place = folder / f"{name}.offsets.npy"
        self._ends = array("q", [0])

    def __enter__(self) -> _BlobWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        np.save(self._place, np.frombuffer(self._ends, dtype=np.int64))

    def add(self, content: bytes) -> None:
        self._stream.write(content)
        self._ends.append(self._ends[-1] + len(content))


def _write_words(folder: Path, ids_of_words: dict[str, int]) -> None:
    rows = sorted((word.encode(), number) for word, number in ids_of_words.items())
    with _BlobWriter(folder, "words") as words:
        for word, _ in rows:
            words.add(word)
    np.save(folder / "words.ids.npy", np.array([number for _, number in rows], dtype=np.int32))


def _digest(corpus: Corpus, folder: Path) -> str:
    """Return the hash of a corpus's content; remembered for a large one as long as its files are not touched."""
    started, stamp = time.time(), corpus.stamp()
    memo = folder / f"{hashlib.blake2b(json.dumps(stamp).encode('utf-8', 'replace'), digest_size=20).hexdigest()}.seen"
    with contextlib.suppress(OSError, ValueError):
        digest = memo.read_text(encoding="ascii")
        if len(digest) == 40 and digest.isalnum():
            return digest
    digest = corpus.digest()
    newest = max(mtime for _, _, mtime, _ in stamp)
    if corpus.size > _SHOW_FROM_BYTES and started - newest / 1e9 > _RACY_S and corpus.stamp() == stamp:
        work = memo.with_suffix(f".{os.getpid()}")
        try:
            work.write_text(digest, encoding="ascii")
            work.replace(memo)
        except OSError:  # a full disk keeps nobody from an index that is there; the next to open it reads the corpus
            work.unlink(missing_ok=True)
    return digest


def cache_folder(cache_dir: str | os.PathLike[str] | None) -> Path:
    """Return where indices and results are kept: the folder that is given, or one in the user's cache folder."""
    if cache_dir is not None:
        folder = Path(cache_dir).expanduser().resolve()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            usable = os.access(folder, os.W_OK | os.X_OK)
        except OSError:
            usable = False
        if not usable:
            raise ArgumentError(f"cache_dir={str(cache_dir)!r} cannot be written to; name another folder")
        return folder
    with contextlib.suppress(OSError, RuntimeError):
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(base).resolve() / "gem" / "search"
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return _own_folder()


def _own_folder() -> Path:
    """Return a folder that lives as long as this process, where the user has no cache folder that can be used."""
    global _temporary
    if _temporary is None or _temporary[0] != os.getpid():
        _temporary = (os.getpid(), tempfile.TemporaryDirectory(prefix="gem-search-"))
        logger.warning("gem: the cache folder cannot be written to; indices are built anew in each process")
    return Path(_temporary[1].name)


_temporary: tuple[int, Any] | None = None


@contextlib.contextmanager
def _only_one_builds(lock: Path) -> Iterator[None]:
    """Let one process at a time build an index; the others wait, and then find it."""
    try:
        import fcntl
    except ImportError:  # Windows: each builds for itself, and the last to finish leaves its index
        yield
        return
    with lock.open("a") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)  # given back by the system, however this process ends
        yield


def _after_fork() -> None:
    global _lock
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
