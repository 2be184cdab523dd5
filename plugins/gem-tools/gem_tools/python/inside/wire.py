"""Messages between the library, the keeper of a sandbox, and the processes that run code: JSON, then raw bytes."""

from __future__ import annotations

import json
import struct
from typing import Any

_LENGTH, _LENGTHS = struct.Struct(">I"), struct.Struct(">II")
MAX_HEADER = 1 << 20
MAX_BODY = 1 << 30


def pack(header: dict[str, Any], body: bytes = b"") -> bytes:
    """Return a message as bytes: two lengths, the header as JSON, and the body."""
    head = json.dumps(header, separators=(",", ":")).encode("ascii")
    return b"".join((_LENGTHS.pack(len(head), len(body)), head, body))


def frame(data: bytes) -> bytes:
    """Return bytes with their length ahead: all that a process that runs code says to its keeper."""
    return _LENGTH.pack(len(data)) + data


def framed(buffer: bytearray, most: int) -> bytes | None:
    """Take the first framed bytes out of a buffer; None while they are not complete.

    Raises:
        WireError: They are more than ``most``.
    """
    if len(buffer) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack_from(buffer)
    if length > most:
        raise WireError(f"a frame of {length} bytes")
    end = _LENGTH.size + length
    if len(buffer) < end:
        return None
    data = bytes(buffer[_LENGTH.size : end])
    del buffer[:end]
    return data


class WireError(Exception):
    """What came is no message."""


class Reader:
    """Puts messages together from pieces of a stream.

    Args:
        max_body: Most bytes in the body of a message; a longer one is an error, before it is taken in.
    """

    def __init__(self, max_body: int = MAX_BODY) -> None:
        self._buffer = bytearray()
        self._max_body = max_body

    def feed(self, data: bytes) -> list[tuple[dict[str, Any], bytes]]:
        """Return the messages that are complete with this piece.

        Raises:
            WireError: The stream holds something else.
        """
        self._buffer += data
        found = []
        while len(self._buffer) >= _LENGTHS.size:
            head, body = _LENGTHS.unpack_from(self._buffer)
            if head > MAX_HEADER or body > self._max_body:
                raise WireError(f"a message of {head} and {body} bytes")
            start = _LENGTHS.size
            end = start + head + body
            if len(self._buffer) < end:
                break
            try:
                header = json.loads(self._buffer[start : start + head])
            except (ValueError, RecursionError) as error:
                raise WireError("a header that is not JSON") from error
            if not isinstance(header, dict):
                raise WireError("a header that is no object")
            found.append((header, bytes(self._buffer[start + head : end])))
            del self._buffer[:end]
        return found
