"""Text that tokenizers and servers take."""

from __future__ import annotations

from typing import Any


def encodable(value: Any) -> Any:
    r"""Return plain data with a question mark for each lone surrogate, which UTF-8 cannot hold.

    A model can write one, as ``"\ud800"`` in the JSON of a call, and environments quote what it wrote.
    """
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode()
    if isinstance(value, dict):
        return {encodable(name): encodable(each) for name, each in value.items()}
    return [encodable(each) for each in value] if isinstance(value, list) else value
