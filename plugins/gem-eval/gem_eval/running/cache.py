"""``ResponseCache``: answers of models by request, so that the same request is not paid twice."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import threading
from pathlib import Path
from typing import Any

from gem_core import Response
from gem_core.errors import ArgumentError
from gem_core.records import to_plain


class ResponseCache:
    """Keeps responses in a file, by all that the request was made of and by the repeat that it was made in.

    Args:
        folder: Where ``responses.sqlite`` is; it is made where it is not there.

    Raises:
        ArgumentError: The file cannot be used.
    """

    def __init__(self, folder: str | Path) -> None:
        self.path = Path(folder) / "responses.sqlite"
        # Agents answer on the library's loop or in the thread of the caller.
        self._lock = threading.Lock()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("CREATE TABLE IF NOT EXISTS responses (key TEXT PRIMARY KEY, response TEXT)")
        except (OSError, sqlite3.Error) as error:
            raise ArgumentError(f"--cache {folder}: cannot use {self.path}: {error}") from error

    def key(self, request: Any) -> str:
        """Return the key of a request: the digest of its plain JSON."""
        return hashlib.sha256(json.dumps(to_plain(request), sort_keys=True).encode("ascii")).hexdigest()

    def find(self, key: str) -> Response | None:
        """Return the response to a request; None where there is none."""
        with self._lock:
            found = self._database.execute("SELECT response FROM responses WHERE key = ?", (key,)).fetchone()
        if found is None:
            return None
        try:
            fields = json.loads(found[0])
            return Response(fields.pop("text"), **fields)
        except (ValueError, TypeError, LookupError, AttributeError):
            return None  # another program wrote it, or it is damaged

    def keep(self, key: str, response: Response) -> None:
        """Keep the response to a request."""
        record = json.dumps({"text": response.text, **to_plain(response.reported())})
        with self._lock:
            self._database.execute("INSERT OR REPLACE INTO responses VALUES (?, ?)", (key, record))

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._database.close()
