"""JSON-RPC messages off the wire: read leniently, within bounds, whatever a server writes."""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Iterator
from typing import Any

from mcp.shared.message import SessionMessage
from mcp.types import JSONRPCError, JSONRPCMessage, jsonrpc_message_adapter

TOO_LONG = -32091
"""Code of our own: the answer was longer than is taken."""

UNREADABLE = -32092
"""Code of our own: the answer was not a JSON-RPC message, or one nested too deeply."""

_HEAD, _TAIL = 1024, 1024
_ID_FIRST = re.compile(rb'\s*\{\s*"jsonrpc"\s*:\s*"2\.0"\s*,\s*"id"\s*:\s*(\d{1,15})\s*,')
_ID_LAST = re.compile(rb',\s*"id"\s*:\s*(\d{1,15})\s*\}\s*\Z')
_SURROGATE = re.compile("[\ud800-\udfff]")


class Lines:
    """Cuts a stream of bytes into messages, one a line.

    A line that is too long is not kept: the request that it answers, where its id can be found at one of its ends, gets
    an error instead. What is no message, such as a server's greeting, is put aside for ``stray``.

    Args:
        max_bytes: Of a line.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max = max_bytes
        self._parts: list[bytes] = []
        self._length = 0
        self._end = b""
        self.stray: deque[str] = deque(maxlen=5)
        """The last lines that were no messages, shortened."""

    def feed(self, chunk: bytes) -> Iterator[SessionMessage]:
        """Take what was read; give the messages that are complete now."""
        start = 0
        while (found := chunk.find(b"\n", start)) >= 0:
            self._keep(chunk[start:found])
            message = self._complete()
            if message is not None:
                yield SessionMessage(message)
            start = found + 1
        self._keep(chunk[start:])

    def _keep(self, piece: bytes) -> None:
        self._length += len(piece)
        if self._length <= self._max:
            self._parts.append(piece)
            return
        if self._parts:  # now it is too long: its ends are enough
            head = b"".join(self._parts)
            self._parts, self._end = [], head[:_HEAD] + b"\n" + head[-_TAIL:]
        head, _, tail = self._end.partition(b"\n")
        self._end = (head or piece[:_HEAD]) + b"\n" + (tail + piece)[-_TAIL:]

    def _complete(self) -> JSONRPCMessage | None:
        too_long, end, line = self._length > self._max, self._end, b"".join(self._parts)
        self._parts, self._length, self._end = [], 0, b""
        if too_long:
            head, _, tail = end.partition(b"\n")
            found = _ID_FIRST.match(head) or _ID_LAST.search(tail)
            if found is not None:
                return failure(int(found.group(1)), TOO_LONG, f"the answer is over {self._max:,} bytes long")
            self.stray.append(shortened(head))
            return None
        if not line.strip():
            return None
        message = parsed(line)
        if message is None:
            self.stray.append(shortened(line))
        return message


def parsed(line: bytes) -> JSONRPCMessage | None:
    """Return the message that a line holds; None for what is none.

    An answer that can be told to be one, and cannot be read, is given as an error: whoever waits for it is not to wait
    until the time is up.
    """
    try:
        return jsonrpc_message_adapter.validate_json(line, by_name=False)
    except ValueError:
        pass
    # Broken Unicode and numbers without limits are refused there, and read here.
    try:
        value = _mended(json.loads(line))
        return jsonrpc_message_adapter.validate_python(value, by_name=False)
    except (ValueError, RecursionError):
        found = _ID_FIRST.match(line[:_HEAD]) or _ID_LAST.search(line[-_TAIL:])
    if found is None:
        return None
    return failure(int(found.group(1)), UNREADABLE, "the answer is not a JSON-RPC message")


def failure(request: int, code: int, message: str) -> JSONRPCError:
    """Return an error in the place of an answer."""
    error = {"jsonrpc": "2.0", "id": request, "error": {"code": code, "message": message}}
    return JSONRPCError.model_validate(error)


def shortened(line: bytes | str, limit: int = 200) -> str:
    """Return a line as it can be shown: one line, and not a long one."""
    text = line[: 4 * limit].decode("utf-8", "replace") if isinstance(line, bytes) else line[: 4 * limit]
    text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return text if len(text) <= limit else f"{text[: limit - 1]}…"


def _mended(value: Any) -> Any:
    """Return plain JSON without the halves of characters that Unicode calls surrogates."""
    if isinstance(value, str):
        return _SURROGATE.sub("\ufffd", value)
    if isinstance(value, list):
        return [_mended(item) for item in value]
    if isinstance(value, dict):
        return {_mended(key): _mended(item) for key, item in value.items()}
    return value
