"""Environments for the tests of vector environments: one walk in four kinds, which fails when it is told to.

Worker processes import this module by its name, so nothing here depends on pytest or on a test.
"""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import gem_core as gem
from gem_core.background import in_thread
from gem_core.types import ResetResult, StepResult

HUNG = threading.Event()
"""Ends what hangs in a thread of this process."""
CLOSED = threading.Semaphore(0)
"""Counts the environments with ``on_close="count"`` that were closed in this process."""
CANCELLED = threading.Event()
"""Set when a coroutine that hangs is cancelled in this process."""

INLINE, THREAD, PROCESS, ASYNC = KINDS = tuple(
    f"vt:Walk-v0-{kind}" for kind in ("inline", "thread", "process", "async")
)
MISSING = "vt:Missing-v0"
"""Its entry point cannot be imported."""
IMAGES = "vt:Images-v0"


class Rubbish:
    """Cannot leave its process."""

    def __reduce__(self) -> Any:
        raise TypeError("no pickle of rubbish")


class OneWay:
    """Can be pickled, but not read again anywhere else than where it was made."""

    def __init__(self) -> None:
        self.made_in = os.getpid()

    def __setstate__(self, state: dict[str, Any]) -> None:
        if state["made_in"] != os.getpid():
            raise TypeError("no way back")
        self.__dict__.update(state)


class MuteError(Exception):
    """An exception that cannot even be shown."""

    def __str__(self) -> str:
        raise ValueError("no words")

    __repr__ = __str__


class PanicError(BaseException):
    """Like the panics of libraries in Rust, which are no ``Exception``."""


class Turns:
    """Lets steps finish in a given order, whatever thread or task they run in.

    Args:
        order: Names, as they may finish.
    """

    def __init__(self, order: list[int]) -> None:
        self._order = list(order)
        self._changed = threading.Condition()

    def wait(self, name: int) -> None:
        """Return when all before it have."""
        with self._changed:
            if name not in self._order:
                return
            if not self._changed.wait_for(lambda: self._order[0] == name, timeout=60):
                raise TimeoutError(f"the turn of {name} never came; left: {self._order}")
            self._order.pop(0)
            self._changed.notify_all()


class WalkEnv(gem.Env):
    """A walk whose length, rewards and observations depend on the seed and on every action so far.

    What an action says after an exclamation mark is done to the environment: ``"raise"``, ``"hang"``, ``"exit"`` …; see
    ``misbehave``. Option ``"fault"`` does it in ``reset``, keyword ``init`` in the constructor.

    Args:
        length: Turns of an episode; 0 draws from 1 to 4.
        init: What happens in the constructor.
        on_close: What happens in ``close``.
        mark: Anything; it has no effect.
    """

    def __init__(self, length: int = 0, init: str = "", on_close: str = "", mark: Any = None) -> None:
        super().__init__()
        self.length, self.on_close, self.mark = length, on_close, mark
        self.closed = False
        misbehave(init)

    def _begun(self, options: dict[str, Any] | None) -> ResetResult:
        fault = (options or {}).get("fault", "")
        if options and "turns" in options:
            options["turns"].wait(options["name"])
        misbehave(fault)
        self.turn, self.path = 0, []
        self.last = (options or {}).get("length") or self.length or int(self.np_random.integers(1, 5))
        return rubbish(fault) or (f"start {int(self.np_random.integers(1000))}", {"turn": 0, "last": self.last})

    def _stepped(self, action: str) -> StepResult:
        word = action.partition("!")[2]
        misbehave(word)
        self.turn += 1
        drawn = int(self.np_random.integers(1000))
        self.path.append(action)
        info: dict[str, Any] = {"turn": self.turn, "path": list(self.path)}
        if word == "unpicklable":
            info["extra"] = Rubbish()
        if word == "one way":
            info["extra"] = OneWay()
        if word == "reported":
            info["error"] = {"kind": "engine", "message": "it is down"}
            return gem.TERMINAL_STATE, 0.0, False, True, info
        if word == "pid":
            info["pid"] = os.getpid()
        over = self.turn >= self.last
        observation = f"{self.turn}: {drawn} after {action!r}"
        return rubbish(word) or (observation, drawn / 1000, over and drawn % 3 > 0, over and drawn % 3 == 0, info)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        return self._begun(options)

    def step(self, action: str) -> StepResult:
        wait_turn(action)
        return self._stepped(action)

    def sample_random_action(self) -> str:
        return f"go {int(self.action_random.integers(1000))}"

    def close(self) -> None:
        self.closed = True
        misbehave(self.on_close)


class ThreadWalkEnv(WalkEnv):
    """The walk, in threads."""

    concurrency = "thread"


class ProcessWalkEnv(WalkEnv):
    """The walk, in processes."""

    concurrency = "process"


class AsyncWalkEnv(gem.AsyncEnv, WalkEnv):
    """The walk, as coroutines."""

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        gem.Env.reset(self, seed=seed)
        await asyncio.sleep(0)
        if (options or {}).get("fault") == "hang":
            await asyncio.Event().wait()
        return self._begun(options)

    async def step_async(self, action: str) -> StepResult:
        await in_thread(wait_turn, action)
        if action.endswith("!hang"):
            try:
                await asyncio.Event().wait()
            finally:
                CANCELLED.set()
        return self._stepped(action)


class ImagesEnv(gem.Env):
    """Gives long texts and images back."""

    concurrency = "process"

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        return "ready", {}

    def step(self, action: str) -> StepResult:
        from PIL import Image

        size = int(action)
        image = Image.frombytes("RGB", (64, 48), self.np_random.bytes(64 * 48 * 3))
        parts = [{"type": "text", "text": "ä" * size}, {"type": "image", "image": image}]
        return parts, float(size), False, False, {"length": len(action)}


TURNS: dict[str, Turns] = {}
"""Orders of this process that actions name; an action ``"3@name"`` waits for turn 3 of it."""


def wait_turn(action: str) -> None:
    """Wait for the turn that an action names, if it names one and the order is of this process."""
    number, at, name = action.partition("@")
    turns = TURNS.get(name.partition("!")[0].partition(" ")[0])
    if at and turns is not None:
        turns.wait(int(number))


CHILD_MARK = "gem-test-child-of-"


def misbehave(how: str) -> None:
    """Do what an environment should not, by its name."""
    if how in RAISED:
        raise RAISED[how]()
    if how in DONE:
        DONE[how]()


def _leave_children() -> None:
    command = [sys.executable, "-S", "-c", "import time; time.sleep(300)", CHILD_MARK + str(os.getpid())]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # that nobody waits for it is the point
        subprocess.Popen(command, stdin=subprocess.DEVNULL)


RAISED: dict[str, Callable[[], BaseException]] = {
    "raise": lambda: RuntimeError("broken on purpose"),
    "mute": MuteError,
    "panic": lambda: PanicError("at the disco"),
    "interrupt": KeyboardInterrupt,
    "quit": lambda: SystemExit(3),
    "cancel": asyncio.CancelledError,
    "leave": GeneratorExit,
}
DONE: dict[str, Callable[[], object]] = {
    "hang": lambda: HUNG.wait(120),
    "exit": lambda: os._exit(7),
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "segv": lambda: ctypes.string_at(0),
    "recurse": lambda: misbehave("recurse"),
    "children": _leave_children,
    "children, hang": lambda: (_leave_children(), HUNG.wait(120)),
    "count": CLOSED.release,
}


def rubbish(how: str) -> Any:
    """Return what is no result, by its name."""
    return {
        "nothing": 5,
        "short": ("a",),
        "number": (5, {}),
        "no reward": ("a", "much", False, False, {}),
        "nan": ("a", float("nan"), False, False, {}),
    }.get(how)


def children_of(pid: int) -> list[int]:
    """Return the processes that ``misbehave("children")`` left behind in a process, by the system's own table."""
    mark = f"{CHILD_MARK}{pid}".encode()
    found = []
    for entry in os.listdir("/proc"):
        try:
            with open(f"/proc/{entry}/cmdline", "rb") as file:
                if entry.isdigit() and mark in file.read().split(b"\0"):
                    found.append(int(entry))
        except OSError:
            continue  # it has ended, or is no process
    return found


def workers_of(pid: int) -> list[int]:
    """Return the worker processes that a program has started, by the system's own table."""
    found = []
    for entry in os.listdir("/proc"):
        try:
            with open(f"/proc/{entry}/stat") as file:
                parent = file.read().rpartition(")")[2].split()[1]
            with open(f"/proc/{entry}/cmdline", "rb") as file:
                if int(parent) == pid and b"gem_core.vector.worker" in file.read():
                    found.append(int(entry))
        except (OSError, ValueError):
            continue  # it has ended, or is no process
    return sorted(found)


def is_alive(pid: int) -> bool:
    """Tell whether a process runs, and is no zombie."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def eventually(condition: Callable[[], object], limit_s: float = 60.0) -> bool:
    """Look until something is so; the limit only ends a hang."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            return False
        gc.collect()
        threading.Event().wait(0.01)
    return True


def register_vector_envs() -> None:
    """Register the environments above."""
    here = "vector_envs"
    classes = (WalkEnv, ThreadWalkEnv, ProcessWalkEnv, AsyncWalkEnv)
    for env_id, cls in zip(KINDS, classes, strict=True):
        gem.register(env_id, f"{here}:{cls.__name__}")
    gem.register(MISSING, "vector_envs_that_are_not_there:Env")
    gem.register(IMAGES, f"{here}:ImagesEnv")


class Computing(gem.Wrapper):
    """A wrapper whose own hooks compute for long."""

    needs = "process"
