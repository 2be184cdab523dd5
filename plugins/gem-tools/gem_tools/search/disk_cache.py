"""Results of servers kept on disk: for any number of processes, bounded, and never in the way of a search."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from gem_tools.search.passages import Passage

T = TypeVar("T")

logger = logging.getLogger("gem_tools")

MOST_BYTES = 256_000_000
"""Of the results, over all servers; beyond, the oldest go."""

_LARGEST_SHARE = 16
"""One result may be this part of the whole at most."""

_FORM = 1
_CHECKED_EVERY = 100
_BUSY_S = 10.0
_TABLE = """
CREATE TABLE IF NOT EXISTS results (
    number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, size INTEGER NOT NULL, passages TEXT NOT NULL
)"""


class DiskCache:
    """Keeps what servers found, in one SQLite file.

    What goes wrong, such as a full disk, is logged once, and the search goes on without the cache. A file that is no
    cache, as after a crash of the machine, is begun anew.

    Args:
        path: The file.
        most_bytes: Of the results that are kept.
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self.path = path
        self.most_bytes = most_bytes
        self._lock = threading.Lock()
        self._connection: tuple[int, sqlite3.Connection] | None = None
        self._until_check = 0
        self._warned = False

    def get(self, server: str, query: str, top_k: int) -> tuple[Passage, ...] | None:
        """Return what a server found before; None where it was not asked, or the cache cannot be read."""

        def read(connection: sqlite3.Connection) -> tuple[Passage, ...] | None:
            key = _key(server, query, top_k)
            row = connection.execute("SELECT passages FROM results WHERE key = ?", (key,)).fetchone()
            return None if row is None else tuple(Passage(*fields) for fields in json.loads(row[0]))

        return self._try(read)

    def put(self, server: str, query: str, top_k: int, passages: tuple[Passage, ...]) -> None:
        """Keep what a server found."""
        # With escapes, since a server may send halves of characters, which SQLite cannot hold.
        text = json.dumps([[p.id, p.title, p.text, p.score, p.url] for p in passages])
        if len(text) * _LARGEST_SHARE > self.most_bytes:
            return

        def write(connection: sqlite3.Connection) -> None:
            with connection:
                connection.execute(
                    "INSERT OR REPLACE INTO results (key, size, passages) VALUES (?, ?, ?)",
                    (_key(server, query, top_k), len(text), text),
                )
                if self._until_check <= 0:
                    self._until_check = _CHECKED_EVERY
                    connection.execute(_DELETE_OLDEST, (self.most_bytes,))
                self._until_check -= 1

        self._try(write)

    def close(self) -> None:
        """Let go of the file; the next search opens it again."""
        with self._lock:
            connection, self._connection = self._connection, None
            if connection is not None and connection[0] == os.getpid():
                connection[1].close()

    def __del__(self) -> None:
        # Since Python 3.13 a connection that is merely forgotten is warned of.
        if getattr(self, "_connection", None) is not None:
            self.close()

    def _try(self, work: Callable[[sqlite3.Connection], T]) -> T | None:
        """Do something with the file; None where that fails."""
        with self._lock:
            try:
                try:
                    return work(self._opened())
                except sqlite3.OperationalError:
                    raise  # it is locked, or the disk is full: the file itself is whole
                except (sqlite3.DatabaseError, TypeError, ValueError):
                    self._begin_anew()
                    return work(self._opened())
            except (sqlite3.Error, OSError) as error:
                if not self._warned:
                    self._warned = True
                    logger.warning("gem: searching without the cache %s: %s", self.path, error)
                return None

    def _opened(self) -> sqlite3.Connection:
        if self._connection is None or self._connection[0] != os.getpid():  # a connection does not survive a fork
            self.path.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(self.path, timeout=_BUSY_S, check_same_thread=False)
            try:
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = NORMAL")
                connection.execute(_TABLE)
            except BaseException:
                connection.close()
                raise
            self._connection = (os.getpid(), connection)
        return self._connection[1]

    def _begin_anew(self) -> None:
        if self._connection is not None:
            self._connection[1].close()
            self._connection = None
        for ending in ("", "-wal", "-shm"):
            with contextlib.suppress(FileNotFoundError):
                self.path.with_name(self.path.name + ending).unlink()


_DELETE_OLDEST = """
DELETE FROM results WHERE number <= (
    SELECT number FROM (SELECT number, SUM(size) OVER (ORDER BY number DESC) AS above FROM results)
    WHERE above > ? ORDER BY number DESC LIMIT 1
)"""


def _key(server: str, query: str, top_k: int) -> str:
    # A hash, since an address may hold a password.
    asked = json.dumps([_FORM, server, query, top_k])
    return hashlib.sha256(asked.encode()).hexdigest()
