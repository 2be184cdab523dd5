"""``images_as_urls``: messages as they go through JSON."""

from __future__ import annotations

import base64
import io
from typing import Any


def images_as_urls(messages: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return messages whose images are PNG data URLs, as in the OpenAI chat API."""
    return [
        {**message, "content": list(map(_part, message["content"]))}
        if isinstance(message["content"], list)
        else message
        for message in messages
    ]


def _part(part: dict[str, Any]) -> dict[str, Any]:
    if part["type"] != "image":
        return part
    file = io.BytesIO()
    part["image"].save(file, "PNG")
    data = base64.b64encode(file.getvalue()).decode()
    return {"type": "image_url", "image_url": {"url": f"data:image/png;base64,{data}"}}
