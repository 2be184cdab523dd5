"""The library's end of the socket to a keeper."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import threading
from typing import Any

from gem_terminal.backends.local.inside import wire
from gem_terminal.errors import EngineError, MachineLostError

_ANSWER_S = 60.0
_WHY = {
    "storage": (
        "the machine was ended: its files grew beyond the {storage_mb} MB that it may write (limits.storage_mb)",
        True,
    ),
}


class Answer:
    """What a keeper answers, once it does."""

    def __init__(self) -> None:
        self.ready = threading.Event()
        self.message: dict[str, Any] | None = None
        self.descriptors: list[int] = []


class Channel:
    """Asks a keeper, from any thread.

    Args:
        link: The socket.
        limits: What the machine may take, for messages.
    """

    def __init__(self, link: socket.socket, limits: dict[str, Any]) -> None:
        self._link, self._limits = link, limits
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._waiting: dict[int, Answer] = {}
        self._lost: tuple[str, bool | None] | None = None
        self.ready = threading.Event()
        self._reader = threading.Thread(target=self._read, name="gem-terminal-local", daemon=True)

    def start(self, settings: dict[str, Any]) -> None:
        """Tell the keeper what it keeps.

        Raises:
            OSError: It is gone.
        """
        wire.send(self._link, settings)
        self._reader.start()

    def ask(
        self, op: str, descriptors: tuple[int, ...] = (), *, timeout_s: float = _ANSWER_S, **words: Any
    ) -> tuple[dict[str, Any], list[int]]:
        """Ask, and wait for the answer; the answer's file descriptors are the caller's.

        Raises:
            MachineLostError: The keeper is gone, or does not answer.
            EngineError: It cannot do what is asked.
        """
        answer = Answer()
        number = next(self._numbers)
        with self._lock:
            if self._lost is not None:
                raise self._error()
            self._waiting[number] = answer
            try:
                wire.send(self._link, {"op": op, "id": number, **words}, descriptors)
            except OSError:
                self._end("the machine is gone: its first process has ended", None)
        if not answer.ready.wait(timeout_s):
            self.end("the machine does not answer", None)
        if answer.message is None:
            raise self._error()
        if "error" in answer.message:
            for descriptor in answer.descriptors:
                os.close(descriptor)
            if answer.message["full"]:
                raise MachineLostError(f"the machine's files are too much: {answer.message['error']}", by_agent=True)
            raise EngineError(answer.message["error"])
        return {**answer.message, "number": number}, answer.descriptors

    def why_lost(self) -> MachineLostError | None:
        """Return what happened to the machine; None while it is there."""
        return None if self._lost is None else self._error()

    def end(self, why: str, by_agent: bool | None) -> None:
        """Close the socket, upon which the keeper ends; what waits for an answer gets an error."""
        with self._lock:
            self._end(why, by_agent)

    def _end(self, why: str, by_agent: bool | None) -> None:
        self._lost = self._lost or (why, by_agent)
        with contextlib.suppress(OSError):  # which says that it is closed already
            self._link.shutdown(socket.SHUT_RDWR)
        if not self._reader.is_alive():  # which closes it otherwise
            self._link.close()
        for answer in self._waiting.values():
            answer.ready.set()
        self._waiting.clear()
        self.ready.set()

    def _error(self) -> MachineLostError:
        why, by_agent = self._lost or ("the machine is gone", None)
        return MachineLostError(why, by_agent=by_agent)

    def _read(self) -> None:
        while True:
            try:
                received = wire.receive(self._link)
            except OSError:
                received = None
            if received is None:
                self.end("the machine is gone: its first process has ended", None)
                self._link.close()
                return
            self._take(*received)

    def _take(self, message: dict[str, Any], descriptors: list[int]) -> None:
        if message.get("op") == "ready":
            self.ready.set()
        elif message.get("op") == "lost":
            words, by_agent = _WHY.get(message["why"], (f"the machine's first process failed: {message['why']}", None))
            self.end(words.format(**self._limits), by_agent)
        else:
            with self._lock:
                answer = self._waiting.pop(message["id"], None)
            if answer is None:
                for descriptor in descriptors:
                    os.close(descriptor)
                return
            answer.message, answer.descriptors = message, descriptors
            answer.ready.set()
