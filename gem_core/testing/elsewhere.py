"""``EnvElsewhere``: the environment under check in another process, which may hang or die."""

from __future__ import annotations

import io
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, partial
from types import FunctionType
from typing import Any

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from gem_core.testing.comparing import record_of
from gem_core.testing.findings import NotTriedError
from gem_core.testing.hostile import hostile_actions
from gem_core.testing.interpreter import CallError, Interpreter
from gem_core.testing.joint import approach, fitted, say_as
from gem_core.testing.remaking import guarded
from gem_core.types import Action


class EnvElsewhere:
    """An environment in another process. Calls raise ``CallError``; results are plain data.

    Args:
        interpreter: Interpreter in which the environment runs.
        step_timeout_s: Limit of a step, in seconds.
        reset_timeout_s: Limit of any other call, in seconds.
    """

    def __init__(self, interpreter: Interpreter, step_timeout_s: float, reset_timeout_s: float) -> None:
        self.call = partial(interpreter.call, timeout_s=reset_timeout_s)
        self._call_step = partial(interpreter.call, timeout_s=step_timeout_s)

    def reset(self, seed: int) -> dict[str, Any]:
        """Begin an episode."""
        return dict(self.call(_reset, seed))

    def step(self, action: Action) -> tuple[dict[str, Any], bool]:
        """Step, and tell whether the episode is over."""
        record, over = self._call_step(_step, action)
        return record, over

    def approach(self, seat: str, *, over: bool, seed: int) -> bool:
        """Play until an agent acts, and tell whether it does."""
        return bool(self.call(_approach, seat, over, seed))

    def step_hostile(self, seat: str, seed: int, number: int) -> bool:
        """Step with a hostile response of an agent, and tell whether the episode is over.

        The response is made there: all are 13 MB.
        """
        return bool(self._call_step(_step_hostile, seat, seed, number))

    def play(self, actions: Iterable[Action]) -> list[dict[str, Any]]:
        """Step until the end of the episode, or the last action."""
        records: list[dict[str, Any]] = []
        for action in actions:
            record, over = self.step(action)
            records.append(record)
            if over:
                break
        return records

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state."""
        self.call(_set_state, state)


class OtherProcess:
    """One interpreter for all environments, one after another: what they import is imported once.

    It is replaced when it has hung or died, and when the path or the current folder of this process has changed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._interpreter: Interpreter | None = None
        self._started_in: tuple[list[str], str] | None = None

    @contextmanager
    def env(self, maker: Callable[[], Any], step_timeout_s: float, reset_timeout_s: float) -> Iterator[EnvElsewhere]:
        """Make an environment there, and close it at the end.

        Raises:
            NotTriedError: There is no other process, or the environment cannot be made there.
            InterpreterLostError: Its constructor hangs, or ends the process.
        """
        packed_maker = packed(maker)
        with self._lock:
            env = EnvElsewhere(self._started(), step_timeout_s, reset_timeout_s)
            try:
                why_not = env.call(_make, packed_maker)
                if why_not:
                    raise NotTriedError(f"in another process it cannot be made there: {why_not}")
                yield env
            finally:
                with suppress(CallError):  # another promise reports it
                    env.call(_close)

    def _started(self) -> Interpreter:
        here = (list(sys.path), os.getcwd())
        if self._interpreter is not None and (self._started_in != here or not self._interpreter.is_alive):
            self._interpreter.close()
            self._interpreter = None
        if self._interpreter is None:
            try:
                self._interpreter, self._started_in = Interpreter(), here
            except CallError as error:
                raise NotTriedError(f"no other process could be started ({error})") from error
        return self._interpreter


OTHER_PROCESS = OtherProcess()


def packed(maker: Callable[[], Any]) -> bytes:
    """Pickle a function that makes an environment; classes that another process cannot import are pickled by value.

    Raises:
        NotTriedError: It cannot be pickled.
    """
    buffer = io.BytesIO()
    try:
        _Packer(buffer).dump(maker)
    except Exception as error:  # pickle calls methods of third-party classes
        why_not = f"{type(error).__name__}: {error}"
        raise NotTriedError(f"its arguments cannot be handed to another process: {why_not}") from error
    return buffer.getvalue()


class _Packer(cloudpickle.Pickler):  # type: ignore[misc]  # as above
    """Pickles the modules of tests by value, too: pytest gives them names that cannot be imported without pytest."""

    def reducer_override(self, obj: Any) -> Any:
        module = sys.modules.get(getattr(obj, "__module__", None) or "")
        if isinstance(obj, type | FunctionType) and module is not None and not _is_found(module):
            cloudpickle.register_pickle_by_value(module)
        return super().reducer_override(obj)


@cache
def _is_found(module: Any) -> bool:
    """Tell whether an import of its name, in an interpreter that has not imported it, leads to the file of a module."""
    package = module.__name__.rpartition(".")[0]
    path = getattr(sys.modules.get(package), "__path__", ()) if package else None
    for finder in sys.meta_path:
        spec = finder.find_spec(module.__name__, path)
        if spec is not None:
            return not spec.has_location or os.path.realpath(spec.origin or "") == os.path.realpath(module.__file__)
    return False


# These functions run in the other process.


def _make(kept: dict[str, Any], packed_maker: bytes) -> str:
    """Make the environment, and return why that cannot be done."""
    try:
        kept["env"] = guarded(pickle.loads(packed_maker)())
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code
        return f"{type(error).__name__}: {error}"
    return ""


def _reset(kept: dict[str, Any], seed: int) -> dict[str, Any]:
    return record_of(kept["env"].reset(seed=seed))


def _step(kept: dict[str, Any], action: Action) -> tuple[dict[str, Any], bool]:
    env = kept["env"]
    result = env.step(fitted(env, action))
    return record_of(result), bool(result[2] or result[3])


def _approach(kept: dict[str, Any], seat: str, over: bool, seed: int) -> bool:
    return approach(kept["env"], seat, over=over, seed=seed)


def _step_hostile(kept: dict[str, Any], seat: str, seed: int, number: int) -> bool:
    if kept.get("hostile_seed") != seed:
        kept["hostile_seed"], kept["hostile_actions"] = seed, hostile_actions(seed=seed)
    env, text = kept["env"], kept["hostile_actions"][number]
    _, _, terminated, truncated, _ = env.step(say_as(env, seat, text))
    return bool(terminated or truncated)


def _set_state(kept: dict[str, Any], state: Mapping[str, Any]) -> None:
    kept["env"].set_state(state)


def _close(kept: dict[str, Any]) -> None:
    if "env" in kept:
        kept.pop("env").close()
