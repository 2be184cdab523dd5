"""Episodes as zstd frames, one after another in a file: ``zstdcat`` prints them as JSON lines."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, BinaryIO

import zstandard

from gem_core.errors import EpisodeFileError

MAX_LINE_BYTES = 2**30
"""A frame that holds more is damaged: a few bytes may claim to hold any length."""

_CHUNK_BYTES = 1 << 14

_LEVEL = 3
_compressor = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)


def pack(record: Any) -> bytes:
    """Return a record as a frame."""
    # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
    line = json.dumps(record, ensure_ascii=True, allow_nan=False)
    return _compressor.compress(line.encode("ascii") + b"\n")


def unpack(frame: bytes) -> Any:
    """Return the record of a frame, or of a line that is not compressed.

    Raises:
        EpisodeFileError: It holds none.
    """
    line = decompressed(frame)
    if line.lstrip()[:1] != b"{":
        raise EpisodeFileError("it is no JSON object")
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise EpisodeFileError(f"it is no valid JSON ({error})") from error


def decompressed(frame: bytes) -> bytes:
    """Return the line of a frame, or a line that is not compressed as it is.

    Raises:
        EpisodeFileError: The frame is damaged.
    """
    if not frame.startswith(zstandard.FRAME_HEADER):
        return frame
    try:
        return zstandard.ZstdDecompressor().decompress(frame, max_output_size=MAX_LINE_BYTES)
    except (zstandard.ZstdError, MemoryError) as error:
        raise EpisodeFileError(f"it is no record of an episode ({error})") from error


def frames(file: BinaryIO, offset: int) -> Iterator[tuple[int, bytes]]:
    """Yield the whole frames of a file from an offset on, each with its own offset; pass over what is damaged."""
    found: int | None = offset
    while found is not None:
        frame = frame_at(file, found)
        if frame is None:
            found = _next_header(file, found + 1)
        else:
            yield found, frame
            found += len(frame)


def frame_at(file: BinaryIO, offset: int) -> bytes | None:
    """Return the frame that begins at an offset; None where it is torn or damaged, or there is none."""
    file.seek(offset)
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    taken = bytearray()
    try:
        while not decompressor.eof:
            chunk = file.read(_CHUNK_BYTES)
            if not chunk:
                return None
            decompressor.decompress(chunk)
            taken += chunk
    except zstandard.ZstdError:
        return None
    return bytes(taken[: len(taken) - len(decompressor.unused_data)])


def _next_header(file: BinaryIO, offset: int) -> int | None:
    """Return where the next frame may begin."""
    header = zstandard.FRAME_HEADER
    while True:
        file.seek(offset)
        chunk = file.read(_CHUNK_BYTES)
        place = chunk.find(header)
        if place >= 0:
            return offset + place
        if len(chunk) < len(header):
            return None
        offset += len(chunk) - len(header) + 1
