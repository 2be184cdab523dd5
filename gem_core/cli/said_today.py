"""Says a plugin's warning once per command and day: what was said is noted in the user's cache folder."""

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
    """Keep back what was said of plugins today already, by the same command in the same environment of Python."""
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
    """Note that something is said now; tell whether it is for the first time today, as far as that can be known."""
    today = datetime.date.today().isoformat()
    # A file for each, without content: two commands at once cannot spoil what the other has noted.
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gem" / "said"
        folder.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            if not file.name.startswith(today):
                file.unlink(missing_ok=True)
        note = folder / f"{today}-{key}"
        known = note.exists()
        note.touch()
    except (OSError, RuntimeError):  # it cannot be written, or there is no home: it is said again, then
        return True
    return not known
