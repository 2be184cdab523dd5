"""Messages between the library and the first process of a sandbox: two lengths, JSON, then raw bytes."""

from __future__ import annotations

import json
import os
import struct
from typing import Any

LENGTHS = struct.Struct(">II")


def head(header: dict[str, Any], body_length: int) -> bytes:
    """Return what stands before the body of a message: two lengths, and the header as JSON."""
    data = json.dumps(header, separators=(",", ":")).encode("ascii")
    return LENGTHS.pack(len(data), body_length) + data


def read_header(descriptor: int) -> tuple[dict[str, Any], int]:
    """Read the header of a message, and no further; return it and the length of the body.

    Raises:
        EOFError: The stream has ended.
    """
    length, body = LENGTHS.unpack(exactly(descriptor, LENGTHS.size))
    return json.loads(exactly(descriptor, length)), body


def exactly(descriptor: int, count: int) -> bytes:
    """Read so many bytes.

    Raises:
        EOFError: The stream has ended.
    """
    data = bytearray()
    while len(data) < count:
        piece = os.read(descriptor, min(count - len(data), 1 << 20))
        if not piece:
            raise EOFError
        data += piece
    return bytes(data)
