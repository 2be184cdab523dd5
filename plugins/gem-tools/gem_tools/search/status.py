"""What ``gem doctor`` says of searching on this machine; loads quickly, and asks no server."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

ARTICLES = Path(__file__).parent / "articles.jsonl"
KEYS = {"serper": "SERPER_API_KEY", "serpapi": "SERPAPI_API_KEY", "tavily": "TAVILY_API_KEY"}
"""Engines of the web, and where each key is read from; a test holds them against ``services``."""


def status() -> dict[str, str]:
    """Return which engines can be used here; of keys only whether they are set."""
    if find_spec("bm25s") is None or find_spec("aiohttp") is None:
        return {"engines": "are not installed: pip install 'gem-tools[search]'"}
    with ARTICLES.open("rb") as file:
        count = sum(1 for _ in file)
    web = ", ".join(engine for engine, name in KEYS.items() if os.environ.get(name, "").strip())
    return {
        "local": f"{count} articles, or corpus=…",
        "retrieve": "SEARCH_URL is set" if os.environ.get("SEARCH_URL", "").strip() else "with url=…",
        "web": web or "no key is set",
    }
