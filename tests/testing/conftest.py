"""Lets tests, and the other process of the checks, import the environments of this folder by name."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
