"""Says a plugin's warning once per command and day: what was said is noted in the user's cache folder."""

from __future__ import annotations

import datetime
import hashlib
import json
import logging
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
    file = _cache_folder() / "said.json"
    try:
        noted = json.loads(file.read_text(encoding="utf-8"))
        keys = list(noted["keys"]) if noted["day"] == today else []
    except (OSError, ValueError, LookupError, TypeError):  # not there, or not ours
        keys = []
    if key in keys:
        return False
    with suppress(OSError):  # it is said again, then
        file.parent.mkdir(parents=True, exist_ok=True)
        # Replaced as a whole, since another command may write or read it at the same time.
        handle, name = tempfile.mkstemp(dir=file.parent, prefix="said-")
        with os.fdopen(handle, "w", encoding="utf-8") as written:
            json.dump({"day": today, "keys": [*keys, key]}, written)
        os.replace(name, file)
    return True


def _cache_folder() -> Path:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gem"
    except RuntimeError:  # there is no home
        return Path(os.devnull)
