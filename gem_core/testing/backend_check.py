"""``check_backend``: runs small tasks by a vector backend, and compares with one environment after another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from gem_core.api import make_vec
from gem_core.errors import ClosedError
from gem_core.testing.comparing import plain
from gem_core.testing.findings import Findings
from gem_core.testing.small_task import SMALL_TASK, register_small_task

_SLOTS = 3
_ROUNDS = [["say 3", "hello", "say 7"], ["", "say 1", "say 1"], ["a", "b", "c"], ["say 5"] * 3]
_BREAKING = ["hello", "break", "hello"]


class _CtrlC(list[str]):
    """Actions that cannot be read to their end, as when a person presses Ctrl-C."""

    def __iter__(self) -> Iterator[str]:
        raise KeyboardInterrupt


def check_backend(backend: str | tuple[str, Mapping[str, Any]]) -> list[str]:
    """Try what a vector backend promises, on a small task in three slots.

    Args:
        backend: The name that it is registered by, or (name, {option: value}).

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownBackendError: There is no backend of this name.
    """
    register_small_task()
    findings = Findings(f"backend {backend!r}")
    vector, model = (make_vec(SMALL_TASK, _SLOTS, backend=each, seed=1) for each in (backend, "sync"))

    def expect_same(promise: str, rounds: list[list[str]]) -> None:
        findings.expect_equal(promise, _play(vector, rounds), _play(model, rounds))

    try:
        expect_same("The same seed and actions give what backend 'sync' gives.", _ROUNDS)
        expect_same("An environment that fails costs its own episode, and is replaced.", [_BREAKING, *_ROUNDS])
        findings.attempt("It gives random actions, and says what stands in a slot.", lambda: _check_calls(vector))
        findings.attempt("Ctrl-C in the middle of a call leaves it usable.", lambda: _check_interrupt(vector))
        expect_same("After Ctrl-C it begins anew, with what backend 'sync' gives.", _ROUNDS)
        vector.reset(seed=2)
        vector.send({0: "a", 2: "b"})
        received: list[int] = []
        while len(received) < 2:
            received += vector.recv(1).slots
        findings.expect("What was sent is received.", sorted(received) == [0, 2], repr(received))
        vector.send(["a"] * _SLOTS)
    finally:
        model.close()
        findings.attempt("It can be closed while something is under way, and once more.", lambda: _check_close(vector))
    try:
        vector.reset()
        findings.expect("What is closed stays closed.", False, "reset() after close() began an episode")
    except ClosedError:
        findings.expect("What is closed stays closed.", True)
    return findings.result()


def _play(vector: Any, rounds: list[list[str]]) -> list[Any]:
    seen: list[Any] = [plain(each) for each in vector.reset(seed=1)]
    for actions in rounds:
        step = vector.step(actions)
        flags = (step.rewards.tolist(), step.terminated.tolist(), step.truncated.tolist())
        seen += [plain(step.observations), *flags, plain(step.infos)]
    return seen


def _check_calls(vector: Any) -> None:
    for slot in range(_SLOTS):
        action, described = vector.sample_random_action(slot), vector.describe(slot)
        if not action.startswith("say ") or described["id"] != SMALL_TASK:
            raise ValueError(f"slot {slot} answered {action!r} and {described!r}")


def _check_interrupt(vector: Any) -> None:
    with suppress(KeyboardInterrupt):
        vector.step(_CtrlC(_BREAKING))


def _check_close(vector: Any) -> None:
    vector.close()
    vector.close()
