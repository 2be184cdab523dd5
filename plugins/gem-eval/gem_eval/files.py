"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path


def write_whole(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file whole or not at all: to another name in its folder first.

    Args:
        path: The file.
        content: What it holds.
        mode: Permissions of the file, less those that the user's umask takes away.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(unfinished, "xb", opener=partial(os.open, mode=mode)) as file:
            file.write(content)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
