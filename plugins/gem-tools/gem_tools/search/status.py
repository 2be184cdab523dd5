"""What ``gem doctor`` says of searching on this machine; loads quickly, and asks no server."""

from __future__ import annotations

import os
from importlib.util import find_spec


def status() -> dict[str, str]:
    """Return which engines can be used here; of addresses and keys only whether they are set."""
    if find_spec("bm25s") is None or find_spec("aiohttp") is None:
        return {"engines": "are not installed: pip install 'gem-tools[search]'"}
    return {
        "local": "with the articles that come along, or corpus=…",
        "retrieve": "SEARCH_URL is set" if os.environ.get("SEARCH_URL", "").strip() else "with url=…",
        "serper": "SERPER_API_KEY is set" if os.environ.get("SERPER_API_KEY", "").strip() else "no key is set",
    }
