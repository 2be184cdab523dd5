"""The words and signs that the grader knows, which stand in ``data/words.toml``."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

WORDS: dict[str, Any] = tomllib.loads((Path(__file__).parents[1] / "data/words.toml").read_text("utf-8"))
