"""What servers answer, as observations: text, images and notes, cut to a budget."""

from __future__ import annotations

import base64
import io
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.types import Observation
from gem_tools.mcp.messages import shortened

MAX_IMAGE_PIXELS = 40_000_000
MAX_BLOCKS = 1000
_PNG = b"\x89PNG\r\n\x1a\n"
_FORMATS = ("PNG", "JPEG", "GIF", "WEBP", "BMP")
"""Those that are read; the decoders of rarer ones are where holes are found."""


@dataclass(frozen=True)
class Budget:
    """How much of a result an agent is given.

    Args:
        max_chars: Characters of text.
        max_images: Images; None of them counts as text.
    """

    max_chars: int = 20_000
    max_images: int = 4

    def __post_init__(self) -> None:
        for option, least in (("max_chars", 100), ("max_images", 0)):
            value = getattr(self, option)
            if type(value) is not int or value < least:
                raise ArgumentError(f"{option} must be a whole number from {least} up, not {value!r}")


def from_call(result: Mapping[str, Any], budget: Budget) -> tuple[Observation, dict[str, Any]]:
    """Return what an agent sees of a tool's result, and what goes to ``info``.

    Structured content is shown where there is no text; a server that gives both is to give the same.
    """
    blocks = _blocks(result.get("content"))
    structured = result.get("structuredContent")
    pieces = _pieces(blocks)
    if structured is not None and not any(isinstance(piece, str) and piece for piece in pieces[: len(blocks)]):
        pieces.append(_as_json(structured))
    info: dict[str, Any] = {}
    if structured is not None and len(_as_json(structured)) <= budget.max_chars:
        info["structured"] = structured
    return _observation(pieces, budget), info


def from_resource(result: Mapping[str, Any], budget: Budget) -> Observation:
    """Return what an agent sees of a resource that it reads."""
    return _observation([_resource(item) for item in _blocks(result.get("contents"))], budget)


def from_prompt(result: Mapping[str, Any], budget: Budget) -> Observation:
    """Return what an agent sees of a prompt."""
    pieces: list[Any] = []
    description = result.get("description")
    if isinstance(description, str) and description.strip():
        pieces.append(description)
    for message in _blocks(result.get("messages")):
        content = message.get("content")
        pieces.append(f"{message.get('role', 'user')}:")
        pieces += _pieces(_blocks(content if isinstance(content, list) else [content]))
    return _observation(pieces, budget)


def cut(text: str, limit: int) -> str:
    """Return a text of at most so many characters, which says how much is missing."""
    if len(text) <= limit:
        return text
    note = f"\n[{len(text):,} characters, of which only the first are shown: ask for less at once.]"
    return text[: max(limit - len(note), 0)] + note


def _blocks(content: object) -> list[Mapping[str, Any]]:
    if not isinstance(content, list):
        return []
    return [block for block in content[:MAX_BLOCKS] if isinstance(block, Mapping)]


def _pieces(blocks: Sequence[Mapping[str, Any]]) -> list[Any]:
    """Return each block as text, or as an image."""
    pieces: list[Any] = []
    for block in blocks:
        kind = block.get("type")
        if kind == "text" and isinstance(block.get("text"), str):
            pieces.append(_clean(block["text"]))
        elif kind == "image":
            pieces.append(_image(block.get("data"), block.get("mimeType")))
        elif kind == "resource_link":
            pieces.append(_link(block))
        elif kind == "resource" and isinstance(block.get("resource"), Mapping):
            pieces.append(_resource(block["resource"]))
        else:
            pieces.append(_note(str(kind), block.get("mimeType"), block.get("data")))
    return pieces


def _resource(item: Mapping[str, Any]) -> Any:
    uri = shortened(str(item.get("uri", "")), 500)
    if isinstance(item.get("text"), str):
        return f"[resource {uri}]\n{_clean(item['text'])}"
    mime = item.get("mimeType")
    if isinstance(mime, str) and mime.startswith("image/"):
        return _image(item.get("blob"), mime)
    return _note(f"resource {uri}", mime, item.get("blob"))


def _link(block: Mapping[str, Any]) -> str:
    known = [block.get("title") or block.get("name"), block.get("mimeType"), block.get("description")]
    about = ", ".join(shortened(word, 300) for word in known if isinstance(word, str) and word)
    return f"[resource {shortened(str(block.get('uri', '')), 500)}{f': {about}' if about else ''}]"


def _note(kind: str, mime: object, data: object) -> str:
    size = f", {len(data) * 3 // 4:,} bytes" if isinstance(data, str) else ""
    form = f", {shortened(mime, 100)}" if isinstance(mime, str) else ""
    return f"[{shortened(kind, 600)}{form}{size}: cannot be shown as text]"


def _image(data: object, mime: object) -> Any:
    """Return an image, or a note in its place where it cannot be read."""
    try:
        from PIL import Image
    except ImportError:
        return _note("image", mime, data)
    try:
        raw = base64.b64decode(data if isinstance(data, str) else b"", validate=False)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow warns of images that unpack to gigabytes
            image = Image.open(io.BytesIO(_bare(raw)), formats=_FORMATS)
            if image.width * image.height > MAX_IMAGE_PIXELS:
                return _note(f"image of {image.width} by {image.height} pixels", mime, data)
            image.load()
    except Exception:  # noqa: BLE001 - decoders fail in all ways on hostile data
        return _note("image that cannot be read", mime, data)
    return image if image.mode in ("RGB", "RGBA", "L") else image.convert("RGBA")


def _bare(raw: bytes) -> bytes:
    """Return a PNG without colour profiles and notes; all else stays as it is.

    Pillow refuses a whole image over the checksum of one of them, which other readers skip.
    """
    start = len(_PNG)
    if not raw.startswith(_PNG):
        return raw
    kept = [_PNG]
    while start + 12 <= len(raw):
        end = start + 12 + int.from_bytes(raw[start : start + 4])
        kind = raw[start + 4 : start + 8]
        if kind[:1].isupper() or kind == b"tRNS":
            kept.append(raw[start:end])
        start = end
    return b"".join(kept)


def _observation(pieces: Sequence[Any], budget: Budget) -> Observation:
    texts = [piece for piece in pieces if isinstance(piece, str)]
    images = [piece for piece in pieces if not isinstance(piece, str)]
    if not images:
        return cut("\n".join(texts), budget.max_chars) if any(texts) else "The result is empty."
    parts: list[dict[str, Any]] = []
    left, shown = budget.max_chars, 0
    for piece in pieces:
        if isinstance(piece, str):
            if left > 0 and piece:
                parts.append({"type": "text", "text": cut(piece, left)})
                left -= len(piece)
        elif shown < budget.max_images:
            parts.append({"type": "image", "image": piece})
            shown += 1
    if shown < len(images):
        parts.append({"type": "text", "text": f"[{len(images) - shown} more images are not shown.]"})
    return parts


def _as_json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _clean(text: str) -> str:
    """Return a text without what terminals and tokenizers stumble over; line breaks and tabs stay."""
    if text.isprintable():
        return text
    return "".join(c for c in text.replace("\r\n", "\n") if c.isprintable() or c in "\n\t" or ord(c) > 0x9F)
