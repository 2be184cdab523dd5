"""``check_wrapper``: puts a wrapper around a small task and tries the promises of both together."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping

from gem_core.env.wrapper import AnyEnv, Wrapper, reset_async, step_async
from gem_core.testing.comparing import play
from gem_core.testing.conformance import check_env
from gem_core.testing.contract import Report
from gem_core.testing.findings import Findings
from gem_core.testing.small_task import SmallTask

_ACTIONS = ("say 3", "hello", "say 7")


def check_wrapper(make_wrapper: Callable[[AnyEnv], AnyEnv], *, skip: Mapping[str, str] | None = None) -> Report:
    """Try everything that a wrapper promises, around a small task of three turns.

    Args:
        make_wrapper: The class, or a function, that puts the wrapper around an environment.
        skip: Promises of ``check_env`` that are not to be tried, each by its slug, with the reason.

    Returns:
        What ``check_env`` says of the two together.

    Raises:
        CheckError: It hides the task, or its asynchronous methods say something else than its plain ones.
        ContractError: Around the task, the contract of environments is broken.
    """
    wrapped = make_wrapper(SmallTask())
    findings = Findings(f"wrapper {type(wrapped).__name__}")
    with contextlib.closing(wrapped):
        promise = "It derives from gem_core.Wrapper."
        if not findings.expect(promise, isinstance(wrapped, Wrapper), f"a {type(wrapped).__name__}"):
            findings.result()
        findings.expect("'unwrapped' is the task.", isinstance(wrapped.unwrapped, SmallTask), repr(wrapped.unwrapped))
        shown = getattr(wrapped, "answer", None)
        findings.expect("Attributes of the task are read through it.", shown == SmallTask.answer, repr(shown))
        plain = list(play(lambda: wrapped.reset(seed=1), wrapped.step, _ACTIONS))
        with asyncio.Runner() as loop:
            coroutines = play(
                lambda: loop.run(reset_async(wrapped, 1)),
                lambda action: loop.run(step_async(wrapped, action)),
                _ACTIONS,
            )
            findings.expect_equal("Its coroutines give what its plain methods give.", list(coroutines), plain)
        findings.result()
        return check_env(wrapped, skip=skip)
