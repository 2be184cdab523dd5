"""A pool of warm sandboxes that run Python: calls wait their turn in it, sessions keep their variables."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import copy
import itertools
import os
import threading
import weakref
from collections.abc import Coroutine, Sequence
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

from gem_core.background import on_library_loop, run_sync
from gem_core.errors import ArgumentError, StateNotSupported
from gem_tools.python import starting
from gem_tools.python.errors import SandboxError
from gem_tools.python.levels import DOCKER_IMAGE, LEVELS
from gem_tools.python.limits import Limits
from gem_tools.python.outcome import Outcome, outcome_from

if TYPE_CHECKING:
    from gem_tools.python.sandbox import Answer, Sandbox

USUAL: tuple[str, ...] = ("bisect", "collections", "copy", "dataclasses", "datetime", "decimal", "fractions", "heapq")
USUAL += ("functools", "itertools", "json", "math", "operator", "random", "re", "statistics", "string", "typing")
"""Modules that every sandbox has imported; they cost nothing to fork."""

_NO_LIMITS = Limits()

T = TypeVar("T")

_lock = threading.Lock()
_pools: weakref.WeakSet[Pool] = weakref.WeakSet()
_shared: dict[tuple[Any, ...], Pool] = {}


class RunOptions(TypedDict, total=False):
    """What ``Pool.run`` may be told besides the code."""

    stdin: str
    limits: Limits
    value: bool


class Pool:
    """Sandboxes that run Python, each one call at a time; further calls wait in the order of their coming.

    Calls come from plain code, from any thread, and from coroutines on any event loop. A process that is forked from
    this one starts sandboxes of its own.

    Args:
        sandbox: ``"bubblewrap"``, ``"docker"`` or ``"process"``; ``"auto"`` for the first of these that works here.
        preload: Further modules that are imported once, before any call; one that is missing is left out.
        num_workers: Sandboxes, hence calls that run at once; by default one for each processor, but two to eight.
        folder_mb: Default size of a call's folder, for the level ``docker`` of all folders.
        image: Image of the level ``docker``, with ``python3``, 3.11 or newer, on its PATH. It is never pulled.

    Raises:
        ArgumentError: An option that cannot be right.
    """

    def __init__(
        self,
        sandbox: str = "auto",
        *,
        preload: Sequence[str] = (),
        num_workers: int | None = None,
        folder_mb: int = _NO_LIMITS.folder_mb,
        image: str | None = None,
    ) -> None:
        if sandbox not in (starting.AUTO, *LEVELS):
            raise ArgumentError(f"sandbox must be one of {', '.join([starting.AUTO, *LEVELS])}, not {sandbox!r}")
        if num_workers is None:
            num_workers = min(8, max(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2))
        if type(num_workers) is not int or not 1 <= num_workers <= 256:
            raise ArgumentError(f"num_workers must be a whole number from 1 to 256, not {num_workers!r}")
        if isinstance(preload, str) or not all(isinstance(name, str) and name for name in preload):
            raise ArgumentError(f"preload must be a list of names of modules, not {preload!r}")
        self.sandbox, self.num_workers = sandbox, num_workers
        self.options: dict[str, Any] = {
            "preload": list(dict.fromkeys([*USUAL, *preload])),
            "folder_mb": folder_mb,
            "folder_files": _NO_LIMITS.folder_files,
            "image": image or DOCKER_IMAGE,
        }
        self._numbers = itertools.count(1)
        self._forget()
        _pools.add(self)

    def _forget(self) -> None:
        self.cells: list[Sandbox] = []
        self.idle: list[Sandbox] = []  # those of `cells` that wait for a call
        # Calls that wait for a sandbox: what gets it, and the one of their session, if any.
        self.waiting: list[tuple[asyncio.Future[Sandbox], Sandbox | None]] = []
        self.chosen: Sandbox | None = None  # the first
        self.passed_over: dict[str, str] = {}
        self._starting = 0
        self._closed = False
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def level(self) -> str | None:
        """The level that calls run in; None before the first sandbox has started."""
        return None if self.chosen is None else self.chosen.launch.level

    def run(self, code: str, **options: Unpack[RunOptions]) -> Outcome:
        """Run a program as ``__main__`` in a process of its own and return its outcome.

        Args:
            code: The program.
            options: ``stdin``, its standard input; ``limits``, what it may use; and ``value``, whether the value of a
                last expression is wanted.

        Raises:
            SandboxError: A sandbox could not be started or was lost: the result is unknown.
            MissingRequirementError: The level that was asked for is not to be had here.
        """
        return run_sync(self._run(code, None, **options))

    async def arun(self, code: str, **options: Unpack[RunOptions]) -> Outcome:
        """Do the same in a coroutine, on any loop. Cancelling it ends the program."""
        return await on_library_loop(self._run(code, None, **options))

    def session(self, limits: Limits = _NO_LIMITS) -> Session:
        """Return a session: calls in one process, which keeps its variables, its folder and its imports.

        Args:
            limits: What each call may use; memory, processes and the folder are those of the whole session.
        """
        return Session(self, limits)

    def start(self) -> str:
        """Start the first sandbox, if none has, and return the level that it has."""
        if self.chosen is None:
            self.run("")
        return self.level or ""

    def close(self) -> None:
        """End every sandbox and whatever runs in it; further calls are refused."""
        for cell in run_sync(self._close()):
            cell.clear()

    async def _close(self) -> list[Sandbox]:
        self._closed = True
        self._refuse_waiting(SandboxError("the pool was closed"))
        cells, self.cells, self.idle = self.cells, [], []
        for cell in cells:
            cell.close()
        return cells

    # What follows runs on the library's loop alone.

    async def _run(
        self,
        code: str,
        session: Session | None,
        *,
        stdin: str = "",
        limits: Limits = _NO_LIMITS,
        value: bool = False,
    ) -> Outcome:
        told = limits.told(session=session is not None)
        job, given = _as_bytes(str(code)), _as_bytes(stdin)
        cell = await self._turn(session)
        header: dict[str, Any] = {"op": "run", "id": next(self._numbers), "limits": told, "value": value}
        header |= {"job": len(job), "input": len(given)}
        if session is not None:
            header["session"] = session.name
            session.cell = cell
        answer, streams = await self._asked(cell, header, job + given)
        if answer["failed"] is not None:
            raise SandboxError(f"no process could be set up in the sandbox: {answer['failed']}")
        if session is not None:
            session.opened = not answer["lost"]
        return outcome_from(answer, streams, told, cell.launch.level)

    async def _asked(self, cell: Sandbox, header: dict[str, Any], body: bytes) -> Answer:
        """Ask a sandbox, and make it idle again when it has answered; a caller that is cancelled ends the call."""
        asking = self._in_background(cell.ask(header, body))
        asking.add_done_callback(lambda _: self._release(cell))
        try:
            return await asyncio.shield(asking)
        except asyncio.CancelledError:
            cell.cancel(header["id"])
            raise

    def _in_background(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Start a task, keep it until it is done, and mark its error as seen."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(lambda done: done.cancelled() or done.exception())
        task.add_done_callback(self._tasks.discard)
        return task

    async def _turn(self, session: Session | None) -> Sandbox:
        """Wait for a sandbox."""
        if self._closed:
            raise SandboxError("the pool is closed")
        bound = None if session is None else session.cell
        if session is not None and bound is not None and not bound.alive:
            session.forget()
            raise SandboxError("the sandbox of this session was lost, and its variables with it")
        turn: asyncio.Future[Sandbox] = asyncio.get_running_loop().create_future()
        self.waiting.append((turn, bound))
        self._serve()
        try:
            return await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled() and turn.exception() is None:
                self._release(turn.result())
            raise

    def _serve(self) -> None:
        """Give idle sandboxes to the calls that wait, in the order of their coming; start more if there are too few."""
        for turn, bound in self.waiting:
            if not self.idle:
                break
            cell = bound or self.idle[0]
            if cell in self.idle and not turn.done():
                self.idle.remove(cell)
                turn.set_result(cell)
        self.waiting = [(turn, bound) for turn, bound in self.waiting if not turn.done()]
        free = sum(1 for _, bound in self.waiting if bound is None)
        while self._starting < free and len(self.cells) + self._starting < self.num_workers:
            self._starting += 1
            self._in_background(self._start_one())

    async def _start_one(self) -> None:
        try:
            cell, passed_over = await starting.start(self.level or self.sandbox, self.options, self._lost)
        except BaseException as error:
            self._starting -= 1
            if not self.cells and not self._starting:
                self._refuse_waiting(error)
            raise
        self._starting -= 1
        if self.chosen is None:
            self.chosen, self.passed_over = cell, passed_over
            starting.warn_of_process(cell, passed_over)
        if self._closed:
            self._clear_later(cell)
        else:
            self.cells.append(cell)
            self._release(cell)

    def _release(self, cell: Sandbox) -> None:
        if cell.alive and cell not in self.idle:
            self.idle.append(cell)
        self._serve()

    def _lost(self, cell: Sandbox) -> None:
        """Go on without a sandbox that has ended: fail the calls of its sessions."""
        if cell not in self.cells:
            return
        self.cells.remove(cell)
        if cell in self.idle:
            self.idle.remove(cell)
        self._refuse_waiting(SandboxError("the sandbox of this session was lost"), cell)
        self._clear_later(cell)
        self._serve()

    def _clear_later(self, cell: Sandbox) -> None:
        cell.close()
        threading.Thread(target=cell.clear, name="gem-python-end", daemon=True).start()

    def _refuse_waiting(self, error: BaseException, cell: Sandbox | None = None) -> None:
        """Fail the calls that wait for a sandbox, or for any."""
        for turn, bound in self.waiting:
            if not turn.done() and (cell is None or bound is cell):
                # A copy for each: one exception that is raised in many places grows with each.
                turn.set_exception(copy.copy(error))

    async def _close_session(self, session: Session) -> None:
        cell, opened = session.cell, session.opened
        if cell is not None and opened and cell.alive and not self._closed:
            with contextlib.suppress(SandboxError):
                await self._turn(session)
                await self._asked(cell, {"op": "close", "id": next(self._numbers), "session": session.name}, b"")
        session.forget()

    def _after_fork(self) -> None:
        for cell in self.cells:
            cell.after_fork()
        self._forget()


class Session:
    """Calls that share their variables. Made by ``Pool.session``; calls of one session run one after another.

    Args:
        pool: Where it runs.
        limits: Of each call.
    """

    def __init__(self, pool: Pool, limits: Limits) -> None:
        self.pool, self.limits = pool, limits
        self.name = os.urandom(8).hex()
        self.cell: Sandbox | None = None
        self.opened = False
        self._one_at_a_time = asyncio.Lock()

    def __deepcopy__(self, memo: dict[int, Any]) -> Session:
        raise StateNotSupported(
            "the variables of a Python session are in its sandbox and cannot be copied; make another environment, "
            "reset it with the same seed and options, and repeat the actions"
        )

    def forget(self) -> None:
        """Let go of the sandbox; the next call begins anew."""
        self.cell, self.opened = None, False

    def run(self, code: str, *, stdin: str = "", value: bool = True) -> Outcome:
        """Run the next piece of code, as ``Pool.run`` does; the value of a last expression is wanted by default.

        Raises:
            SandboxError: The sandbox was lost, and the variables with it; the next call begins anew.
        """
        return run_sync(self._run(code, stdin, value))

    async def arun(self, code: str, *, stdin: str = "", value: bool = True) -> Outcome:
        """Do the same in a coroutine, on any loop."""
        return await on_library_loop(self._run(code, stdin, value))

    async def _run(self, code: str, stdin: str, value: bool) -> Outcome:
        async with self._one_at_a_time:
            return await self.pool._run(code, self, stdin=stdin, limits=self.limits, value=value)

    def close(self) -> None:
        """End it, its process and its folder."""
        if self.cell is not None:
            run_sync(self._close())

    async def aclose(self) -> None:
        """Do the same in a coroutine, on any loop."""
        if self.cell is not None:
            await on_library_loop(self._close())

    async def _close(self) -> None:
        async with self._one_at_a_time:
            await self.pool._close_session(self)


def shared_pool(
    sandbox: str = "auto",
    *,
    preload: Sequence[str] = (),
    num_workers: int | None = None,
    folder_mb: int = _NO_LIMITS.folder_mb,
    image: str | None = None,
) -> Pool:
    """Return this process's pool with these settings, the same for everyone who asks; see ``Pool``."""
    key = (sandbox, tuple(preload), num_workers, folder_mb, image)
    with _lock:
        if key not in _shared:
            _shared[key] = Pool(sandbox, preload=preload, num_workers=num_workers, folder_mb=folder_mb, image=image)
        return _shared[key]


def _as_bytes(text: str) -> bytes:
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # a lone surrogate that stands for no byte
        return text.encode("utf-8", "surrogatepass")


def close_all() -> None:
    """End all sandboxes of this process; also happens when it ends."""
    with _lock:
        pools = list(_pools)
        _shared.clear()
    for pool in pools:
        if pool.cells or pool._starting:
            with contextlib.suppress(Exception):
                pool.close()


def _after_fork() -> None:
    global _lock
    _lock = threading.Lock()
    for pool in list(_pools):
        pool._after_fork()


atexit.register(close_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
