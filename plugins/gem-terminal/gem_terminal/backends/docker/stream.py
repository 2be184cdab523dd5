"""``Stream``: the connection that the engine hands over once it runs something whose input and output it carries."""

from __future__ import annotations

import contextlib
import socket
import time
from typing import TYPE_CHECKING, Any, cast

from gem_terminal.backends.docker.engine import FAILURES, Client

if TYPE_CHECKING:
    import requests

_CHUNK = 65536
_HEADER = 8


class Stream:
    """Bytes to and from a program in a container. For one reader and one writer at a time.

    Args:
        client: The client.
        path: What is asked of the engine, as ``/exec/ID/start``.
        framed: Whether the engine puts a header before each piece, as it does where there is no terminal.
        body: What is said to it.
        params: Parameters of the question.
    """

    def __init__(
        self,
        client: Client,
        path: str,
        *,
        framed: bool,
        body: dict[str, Any] | None = None,
        params: dict[str, Any] | None = None,
    ) -> None:
        self._framed = framed
        self._pending = b""
        self._left = 0
        self._ended = False
        # Without a body where none is asked for: the engine may take it for what the program is to read.
        headers = {"Connection": "Upgrade", "Upgrade": "tcp"}
        self._response = client.ask("POST", path, json=body, params=params, headers=headers, stream=True)
        try:
            self._socket, self._pending = _taken(self._response)
        except BaseException:
            self._response.close()
            raise

    def read(self, timeout_s: float) -> bytes | None:
        """Return the next bytes; ``b""`` when time has passed, None when there will be no more."""
        deadline = time.monotonic() + timeout_s
        while True:
            data = self._piece()
            if data:
                return data
            if self._ended:
                return None
            left = deadline - time.monotonic()
            if left <= 0 and timeout_s > 0:
                return b""
            if not self._receive(max(left, 0.0)):
                return None if self._ended else b""

    def write(self, data: bytes, timeout_s: float) -> int:
        """Send bytes, for so long as the other side takes them; return how many were sent.

        Raises:
            OSError: The connection is gone.
        """
        deadline = time.monotonic() + timeout_s
        sent = 0
        view = memoryview(data)
        while sent < len(data):
            left = deadline - time.monotonic()
            if left <= 0:
                break
            self._socket.settimeout(left)
            try:
                sent += self._socket.send(view[sent : sent + _CHUNK])
            except TimeoutError:
                break
        return sent

    def close(self) -> None:
        """Let go of the connection; may be called again."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(*FAILURES):
            self._socket.close()
        with contextlib.suppress(*FAILURES):
            self._response.close()
        self._ended = True

    def _receive(self, timeout_s: float) -> bool:
        try:
            self._socket.settimeout(timeout_s)
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            return False
        except (OSError, ValueError):
            data = b""
        if not data:
            self._ended = True
            return False
        self._pending += data
        return True

    def _piece(self) -> bytes:
        """Take what has come, without the headers."""
        if not self._framed:
            data, self._pending = self._pending, b""
            return data
        pieces = []
        while self._pending:
            if not self._left:
                if len(self._pending) < _HEADER:
                    break
                self._left = int.from_bytes(self._pending[4:_HEADER], "big")
                self._pending = self._pending[_HEADER:]
            pieces.append(self._pending[: self._left])
            self._pending = self._pending[self._left :]
            self._left -= len(pieces[-1])
        return b"".join(pieces)


def _taken(response: requests.Response) -> tuple[Any, bytes]:
    """Return the socket below a response, and what was read of it together with the headers.

    The engine may send a program's first words in one piece with its own: docker's client would lose them
    (docker 7.2, ``_get_raw_response_socket``).
    """
    below: Any = cast("Any", response.raw)._fp.fp
    connection = getattr(below, "channel", None)  # as over SSH
    if connection is not None:
        return connection, b""
    connection = below.raw._sock
    connection.settimeout(0)
    try:
        early = below.peek()
    except (BlockingIOError, TimeoutError, OSError):
        early = b""
    return connection, bytes(early)


def connection_of(response: requests.Response) -> Any:
    """Return the socket below a response, for cutting it off from another thread."""
    below: Any = cast("Any", response.raw)._fp.fp
    return getattr(below, "channel", None) or below.raw._sock
