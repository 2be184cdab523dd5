"""What goes over a connection between a host and a worker: messages as bytes, each packed by itself.

What one slot is asked or answers may be impossible to pack, or to read on the other side. It is then a ``Failure`` in
its place, and the other messages arrive.
"""

from __future__ import annotations

import pickle
import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.errors import ArgumentError
from gem_core.records.plain_json import to_plain
from gem_core.vector.commands import Failure

Message = tuple[Any, ...]
"""Its first part says what it is, and its last what it is about; those between are plain."""

_LONGEST_MESSAGE = 2000


class Outbox:
    """Sends messages over a connection from a thread of its own, so that nobody waits for the other side to read.

    What has come together by the time that the thread looks goes out as one.

    Args:
        send: Sends bytes; it may block, and raises ``OSError`` when the other side is gone.
        first: Sent by itself before any message.
        failed: Called when nothing can be sent any more, for want of memory; by default the thread just ends.
    """

    def __init__(
        self, send: Callable[[bytes], None], first: bytes = b"", failed: Callable[[], object] = lambda: None
    ) -> None:
        self._send = send
        self._first = first
        self._failed = failed
        self._queue: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="gem-outbox", daemon=True)
        self._thread.start()

    def put(self, message: Message) -> None:
        """Send a message, in order, at some time."""
        self._queue.put(message)

    def close(self, timeout: float | None = None) -> None:
        """Send what is still there, and end the thread."""
        self._queue.put(None)
        self._thread.join(timeout)

    def _serve(self) -> None:
        try:
            if self._first:
                self._send(self._first)
            for batch in batches(self._queue):
                self._send(batch)
        except OSError:
            return  # whoever reads the other way finds out that it is gone
        except MemoryError:
            self._failed()


def batches(messages: queue.SimpleQueue[Message | None]) -> Iterator[bytes]:
    """Yield messages as bytes, each time all that have come together, until one of them is None."""
    over = False
    while not over:
        together = [messages.get()]
        while not messages.empty():
            together.append(messages.get())
        over = None in together
        yield to_bytes([message for message in together if message is not None])


def to_bytes(messages: list[Message]) -> bytes:
    """Return messages as bytes."""
    return pickle.dumps([(message[:-1], _packed(message)) for message in messages], protocol=5)


def from_bytes(data: bytes) -> list[Message]:
    """Return the messages that were made bytes."""
    return [_unpacked(head, content) for head, content in pickle.loads(data)]


def _packed(message: Message) -> bytes:
    try:
        return pickle.dumps(message[-1], protocol=5)
    except Exception as error:  # noqa: BLE001 - an object's own pickling may fail in any way
        problem = error
    if message[0] == "wrapped":
        return pickle.dumps(to_plain(message[-1]), protocol=5)  # as it would stand in a file of episodes
    if message[0] == "do":
        try:
            return bytes(cloudpickle.dumps(message[-1]))  # lambdas, and what a script defines itself
        except Exception as error:  # noqa: BLE001 - as above
            problem = error
    return pickle.dumps(_failure(message[0], _name(message), "cannot be sent to", problem), protocol=5)


def _unpacked(head: Message, content: bytes) -> Message:
    try:
        return (*head, pickle.loads(content))
    except Exception as error:  # noqa: BLE001 - as above
        if head[0] == "wrapped":
            return (*head, [])
        return (*head, _failure(head[0], _name(head), "cannot be read in", error))


def _name(message: Message) -> str:
    if message[0] == "do":
        return "its action" if isinstance(message[-1], str) else "what it is made from"
    return "a question" if message[0] == "ask" else "its result"


def _failure(kind: str, thing: str, what: str, error: Exception) -> Failure:
    failure = Failure.of(error, "")
    text = f"{thing} {what} another process:{failure.message.removeprefix(' raised')}"[:_LONGEST_MESSAGE]
    # Keyword arguments or options of a plan that cannot travel are not mended by trying the next.
    return Failure("exception", text, ArgumentError(text) if kind == "do" else None, hopeless=kind == "do")
