"""Messages between the library and a keeper: JSON, one to a packet, with file descriptors beside it."""

from __future__ import annotations

import json
import os
import socket
from typing import Any

_MOST_INLINE = 32_768
MOST_DESCRIPTORS = 64


def send(channel: socket.socket, message: dict[str, Any], descriptors: tuple[int, ...] = ()) -> None:
    """Send a message; one too long for a packet goes as a file in memory.

    Raises:
        OSError: The other side is gone.
    """
    data = json.dumps(message).encode("ascii")
    if len(data) <= _MOST_INLINE:
        socket.send_fds(channel, [b"m" + data], descriptors)
        return
    memory = in_memory(data)
    try:
        socket.send_fds(channel, [b"f"], (memory, *descriptors))
    finally:
        os.close(memory)


def receive(channel: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Return the next message and what file descriptors came with it; None when the other side is gone.

    Raises:
        OSError: The other side is gone.
    """
    data, descriptors, _, _ = socket.recv_fds(channel, _MOST_INLINE + 1, MOST_DESCRIPTORS + 1, socket.MSG_CMSG_CLOEXEC)
    if not data:
        return None
    if data[:1] == b"f":
        with open(descriptors.pop(0), "rb") as file:
            file.seek(0)
            return json.loads(file.read()), descriptors
    return json.loads(data[1:]), descriptors


def in_memory(data: bytes) -> int:
    """Return a file descriptor of a file in memory, at its end."""
    memory = os.memfd_create("gem", os.MFD_CLOEXEC)
    view = memoryview(data)
    while view:
        view = view[os.write(memory, view) :]
    return memory
