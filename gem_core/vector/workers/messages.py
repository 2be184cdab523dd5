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
from gem_core.vector.commands import Failure

if TYPE_CHECKING:
    from queue import SimpleQueue

WorkerMessage = tuple[Any, ...]

_THINGS = {"do": "what it is made from", "call": "a question"}
"""What errors call the last part of a message, by the kind of that."""

_LONGEST_MESSAGE = 2000


def batches(messages: SimpleQueue[WorkerMessage | None]) -> Iterator[bytes]:
    """Yield messages as bytes, each time all that have come together, until one of them is None."""
    over = False
    while not over:
        together = [messages.get()]
        while not messages.empty():
            together.append(messages.get())
        over = None in together
        yield to_bytes([message for message in together if message is not None])


def to_bytes(messages: list[WorkerMessage]) -> bytes:
    """Return messages as bytes."""
    return pickle.dumps([(message[:-1], _packed(message)) for message in messages], protocol=5)


def from_bytes(data: bytes) -> list[WorkerMessage]:
    """Return the messages that ``to_bytes`` was given."""
    return [_unpacked(head, content) for head, content in pickle.loads(data)]


def _packed(message: WorkerMessage) -> bytes:
    kind, content = message[0], message[-1]
    try:
        return pickle.dumps(content, protocol=5)
    except Exception as error:  # noqa: BLE001 - an object's own pickling may raise anything
        problem = error
    if kind == "made":
        return pickle.dumps(to_plain(content), protocol=5)  # as it would stand in a file of episodes
    if kind == "do":
        try:
            return bytes(cloudpickle.dumps(content))  # lambdas, and what a script defines itself
        except Exception as error:  # noqa: BLE001 - as above
            problem = error
    thing = "its action" if kind == "do" and isinstance(content, str) else _THINGS.get(kind, "its result")
    return pickle.dumps(_failure(kind, f"{thing} cannot be sent to", problem), protocol=5)


def _unpacked(head: WorkerMessage, content: bytes) -> WorkerMessage:
    try:
        return (*head, pickle.loads(content))
    except Exception as error:  # noqa: BLE001 - as above
        return (*head, _failure(head[0], f"{_THINGS.get(head[0], 'its result')} cannot be read in", error))


def _failure(kind: str, what: str, error: Exception) -> Failure:
    text = f"{what} another process:{Failure.of(error, '').message.removeprefix(' raised')}"[:_LONGEST_MESSAGE]
    # Keyword arguments or options of a plan that cannot be sent are not mended by trying the next.
    return Failure("exception", text, ArgumentError(text) if kind == "do" else None, permanent=kind == "do")
