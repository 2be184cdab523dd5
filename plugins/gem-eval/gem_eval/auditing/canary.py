"""``Canary``: a file that only code which was run could have written."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Literal

Found = Literal["", "here", "elsewhere"]


class Canary:
    """A folder for files that responses try to write; whoever finds one there knows that the response was run.

    Its name cannot be guessed, so nothing else writes there.
    """

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="gem-audit-"))
        self.path = str(self._folder / "written")

    def taken(self) -> Found:
        """Say who ran the response: this process, another one on this machine, or none; and forget it."""
        file = Path(self.path)
        if not file.exists():
            return ""
        who = file.read_text(encoding="utf-8", errors="replace").strip() if file.is_file() else ""
        shutil.rmtree(file) if file.is_dir() else file.unlink()
        return "here" if who == str(os.getpid()) else "elsewhere"

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def python(self) -> str:
        """An expression that writes the file."""
        return f"__import__('pathlib').Path({self.path!r}).write_text(str(__import__('os').getpid()))"

    @property
    def shell(self) -> str:
        """A command that writes the file."""
        return f"echo shell > {self.path}"

    @property
    def yaml(self) -> str:
        """A document that writes it, where YAML is loaded without safety."""
        return f'!!python/object/apply:os.mkdir ["{self.path}"]'
