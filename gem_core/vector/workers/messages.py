"""Messages between the process of a vector environment and its workers, as bytes.

To a worker go ``("do", slot, ticket, command)``, ``("call", number, slot, (method, args))``, ``("release", slot)`` and
``("know", records)``; back come ``("done", slot, ticket, outcome)``, ``("answer", number, value)``, ``("made", slot,
description)``, once for each environment that is made, and ``("broken", failure)``.

The last part of each is pickled by itself: where it cannot be pickled, or read on the other side, a ``Failure`` takes
its place, and the other messages arrive.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.errors import ArgumentError
from gem_core.records.plain_json import to_plain
from gem_core.vector.commands import Failure, Rebuild, Reset

if TYPE_CHECKING:
    from queue import SimpleQueue

WorkerMessage = tuple[Any, ...]

_CONTENT_NAMES = {"do": "what it is made from", "call": "a question"}
"""Name of the last part of a message in errors, by the kind of message."""

_LONGEST_MESSAGE = 2000


def batches(messages: SimpleQueue[WorkerMessage | None]) -> Iterator[bytes]:
    """Yield messages as bytes, each time all that are in the queue, until one of them is None."""
    over = False
    while not over:
        together = [messages.get()]
        while not messages.empty():
            together.append(messages.get())
        over = None in together
        yield to_bytes([message for message in together if message is not None])


def to_bytes(messages: list[WorkerMessage]) -> bytes:
    """Return messages as bytes."""
    return pickle.dumps([(message[:-1], _pack(message)) for message in messages], protocol=5)


def from_bytes(data: bytes) -> list[WorkerMessage]:
    """Return the messages that ``to_bytes`` was given."""
    return [_unpack(head, content) for head, content in pickle.loads(data)]


def _pack(message: WorkerMessage) -> bytes:
    kind, content = message[0], message[-1]
    try:
        return pickle.dumps(content, protocol=5)
    except Exception as error:  # noqa: BLE001 - an object's own pickling may raise anything
        problem = error
    if kind == "made":
        return pickle.dumps(to_plain(content), protocol=5)  # in the form that an episode file has
    if kind == "do":
        try:
            return bytes(cloudpickle.dumps(content))  # lambdas, and classes defined in a script
        except Exception as error:  # noqa: BLE001 - as above
            problem = error
    is_action = kind == "do" and not isinstance(content, Reset | Rebuild)
    thing = "its action" if is_action else _CONTENT_NAMES.get(kind, "its result")
    return pickle.dumps(_failure(kind, f"{thing} cannot be sent to", problem), protocol=5)


def _unpack(head: WorkerMessage, content: bytes) -> WorkerMessage:
    try:
        return (*head, pickle.loads(content))
    except Exception as error:  # noqa: BLE001 - as above
        return (*head, _failure(head[0], f"{_CONTENT_NAMES.get(head[0], 'its result')} cannot be read in", error))


def _failure(kind: str, what: str, error: Exception) -> Failure:
    text = f"{what} another process:{Failure.of(error, '').message.removeprefix(' raised')}"[:_LONGEST_MESSAGE]
    # Trying the next item would not help if the keyword arguments or options of a plan cannot be sent.
    return Failure("exception", text, ArgumentError(text) if kind == "do" else None, permanent=kind == "do")
