"""Styles, scripts and frames of the pages, and how a page that is one file takes them in."""

from __future__ import annotations

import base64
import hashlib
from importlib import resources


def read_assets(*names: str) -> str:
    """Return the text of files of this folder, one after the other, with line feeds alone: a policy has their hash."""
    folder = resources.files(__name__)
    return "".join((folder / name).read_text(encoding="utf-8").replace("\r\n", "\n") for name in names)


def hash_source(text: str) -> str:
    """Return what allows a style or a script by its hash in a Content-Security-Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"
