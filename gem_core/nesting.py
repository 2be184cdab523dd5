"""How deep plain data is nested: what is deeper than our limit is kept out of records."""

from __future__ import annotations


def is_deep(value: object, limit: int = 100) -> bool:
    """Tell whether lists and objects are nested deeper than what copies and writes them can follow."""
    level = [value]
    for _ in range(limit):
        level = [
            part
            for item in level
            if isinstance(item, dict | list)
            for part in (item.values() if isinstance(item, dict) else item)
        ]
    return bool(level)
