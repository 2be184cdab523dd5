"""Show a plugin's warning once per command and day, as recorded in the user's cache folder."""

from __future__ import annotations

import datetime
import hashlib
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def said_once(command: str) -> Iterator[None]:
    """Hide warnings that the same command in the same Python environment has already shown today."""
    logger = logging.getLogger("gem_core.registry.plugins")

    def is_new(record: logging.LogRecord) -> bool:
        said = f"{command}\n{sys.prefix}\n{record.getMessage()}"
        return _note(hashlib.sha256(said.encode(errors="replace")).hexdigest())

    logger.addFilter(is_new)
    try:
        yield
    finally:
        logger.removeFilter(is_new)


def _note(key: str) -> bool:
    """Record that a message is shown now; tell whether it is the first time today, as far as is known."""
    today = datetime.date.today().isoformat()
    # An empty file for each message: two commands at once cannot damage each other's record.
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gem" / "said"
        folder.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            if not file.name.startswith(today):
                file.unlink(missing_ok=True)
        note = folder / f"{today}-{key}"
        known = note.exists()
        note.touch()
    except (OSError, RuntimeError):  # not writable, or there is no home: the message is shown again
        return True
    return not known
