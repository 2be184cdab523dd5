"""What servers answer, as observations: text, images and notes, cut to a budget."""

from __future__ import annotations

import base64
import io
import json
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.types import Observation
from gem_tools.mcp.text import cleaned, cut, shortened

MAX_IMAGE_PIXELS = 40_000_000
MAX_BLOCKS = 1000
_FORMATS = ("PNG", "JPEG", "GIF", "WEBP", "BMP")
"""Those that are read; the decoders of rarer ones are where holes are found."""


def from_call(
    result: Mapping[str, Any], max_chars: int = 20_000, max_images: int = 4
) -> tuple[Observation, dict[str, Any]]:
    """Return what an agent sees of a tool's result, and what goes to ``info``.

    Structured content is shown where there is no text; a server that gives both is to give the same.
    """
    blocks = result.get("content")
    blocks = blocks[:MAX_BLOCKS] if isinstance(blocks, list) else []
    pieces = [_piece(block) for block in blocks if isinstance(block, Mapping)]
    structured = result.get("structuredContent")
    if structured is None:
        return _observation(pieces, max_chars, max_images), {}
    as_json = json.dumps(structured, ensure_ascii=False)
    if not any(isinstance(piece, str) and piece for piece in pieces):
        pieces.append(as_json)
    return _observation(pieces, max_chars, max_images), {"structured": structured} if len(as_json) <= max_chars else {}


def _piece(block: Mapping[str, Any]) -> Any:
    """Return a block as text, or as an image."""
    kind, resource = block.get("type"), block.get("resource")
    if kind == "text" and isinstance(block.get("text"), str):
        return cleaned(block["text"])
    if kind == "image":
        return _image(block.get("data"), block.get("mimeType"))
    if kind == "resource" and isinstance(resource, Mapping):
        return _resource(resource)
    if kind == "resource_link":
        known = [block.get("title") or block.get("name"), block.get("mimeType"), block.get("description")]
        about = ", ".join(shortened(word, 300) for word in known if isinstance(word, str) and word)
        return f"[resource {shortened(str(block.get('uri', '')), 500)}{f': {about}' if about else ''}]"
    return _note(str(kind), block.get("mimeType"), block.get("data"))


def _resource(item: Mapping[str, Any]) -> Any:
    uri = shortened(str(item.get("uri", "")), 500)
    if isinstance(item.get("text"), str):
        return f"[resource {uri}]\n{cleaned(item['text'])}"
    mime = item.get("mimeType")
    if isinstance(mime, str) and mime.startswith("image/"):
        return _image(item.get("blob"), mime)
    return _note(f"resource {uri}", mime, item.get("blob"))


def _note(kind: str, mime: object, data: object) -> str:
    size = f", {len(data) * 3 // 4:,} bytes" if isinstance(data, str) else ""
    form = f", {shortened(mime, 100)}" if isinstance(mime, str) else ""
    return f"[{shortened(kind, 600)}{form}{size}: cannot be shown as text]"


def _image(data: object, mime: object) -> Any:
    """Return an image, or a note in its place where it cannot be read."""
    from PIL import Image

    try:
        raw = base64.b64decode(data if isinstance(data, str) else b"", validate=False)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow warns of images that unpack to gigabytes
            image = Image.open(io.BytesIO(raw), formats=_FORMATS)
            if image.width * image.height > MAX_IMAGE_PIXELS:
                return _note(f"image of {image.width} by {image.height} pixels", mime, data)
            image.load()
    except Exception:  # noqa: BLE001 - decoders fail in all ways on hostile data
        return _note("image that cannot be read", mime, data)
    return image if image.mode in ("RGB", "RGBA", "L") else image.convert("RGBA")


def _observation(pieces: Sequence[Any], max_chars: int, max_images: int) -> Observation:
    texts = [piece for piece in pieces if isinstance(piece, str)]
    if len(texts) == len(pieces):
        return cut("\n".join(texts), max_chars) if any(texts) else "The result is empty."
    parts: list[dict[str, Any]] = []
    chars, images = max_chars, max_images
    for piece in pieces:
        if not isinstance(piece, str):
            images -= 1
            parts += [{"type": "image", "image": piece}] if images >= 0 else []
        elif piece and chars > 0:
            parts.append({"type": "text", "text": cut(piece, chars)})
            chars -= len(piece)
    if images < 0:
        parts.append({"type": "text", "text": f"[{-images} more images are not shown.]"})
    return parts
