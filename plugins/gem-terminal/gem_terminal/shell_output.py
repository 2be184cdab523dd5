"""The output of a command, kept within bounds: its beginning and its end."""

from __future__ import annotations

from collections import deque

from gem_terminal.plain_text import plain_text


class Output:
    """Takes output of any length, and gives it as text with its middle left out.

    Args:
        most: Characters of the text, a note of what was left out apart.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        # More is kept than is shown, since what was overwritten and what steers the terminal is taken out.
        self._room = min(max(4 * most, 65_536), 1_000_000)
        self.clear()

    def clear(self) -> None:
        """Forget what came so far."""
        self._head = bytearray()
        self._tail: deque[bytes] = deque()
        self._in_tail = 0
        self._dropped = 0

    def feed(self, data: bytes) -> None:
        """Take what came."""
        if len(self._head) < self._room:
            room = self._room - len(self._head)
            self._head += data[:room]
            data = data[room:]
        if not data:
            return
        self._tail.append(data)
        self._in_tail += len(data)
        while self._in_tail - len(self._tail[0]) >= self._room:
            gone = len(self._tail.popleft())
            self._in_tail -= gone
            self._dropped += gone

    def has(self, data: bytes) -> bool:
        """Tell whether something is at the beginning of what came."""
        return data in self._head[:1000]

    def text(self) -> tuple[str, int]:
        """Return the text, and how much was left out of it: bytes as they came, or characters as they are shown."""
        head, tail, dropped = bytes(self._head), b"".join(self._tail), self._dropped
        if len(tail) > self._room:
            dropped += len(tail) - self._room
            tail = tail[-self._room :]
        if not dropped:
            return _cut(_decoded(head + tail), self._most)
        before, after = _decoded(head), _decoded(_from_character(tail))
        half = self._most // 2
        dropped += max(0, len(before) - half) + max(0, len(after) - half)
        return _joined(before[:half], after[-half:] if half else "", dropped), dropped


def _decoded(data: bytes) -> str:
    return plain_text(data.decode("utf-8", "replace"))


def _from_character(data: bytes) -> bytes:
    """Return the data without the rest of a character at its beginning."""
    start = 0
    while start < min(3, len(data)) and data[start] & 0xC0 == 0x80:
        start += 1
    return data[start:]


def _cut(text: str, most: int) -> tuple[str, int]:
    if len(text) <= most:
        return text, 0
    half = most // 2
    dropped = len(text) - 2 * half
    return _joined(text[:half], text[len(text) - half :], dropped), dropped


def _joined(before: str, after: str, dropped: int) -> str:
    return f"{before}\n[… {dropped} characters left out …]\n{after}"
