"""What ``info`` says of commands and verdicts, as plain JSON and bounded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_terminal.actions import Action
    from gem_terminal.shell import CommandResult, ScreenResult
    from gem_terminal.verifying.verdict import Verdict

_MOST_TESTS = 1_000
_MOST_CHARACTERS = 4_000


def command_info(result: CommandResult) -> dict[str, Any]:
    """Return what ``info["terminal"]`` says of a command."""
    return {
        "exit_code": result.exit_code,
        "timed_out": result.timed_out,
        "workdir": result.workdir,
        "dropped": result.dropped,
        "restarted": result.restarted,
        "waiting": result.waiting,
    }


def screen_info(result: ScreenResult) -> dict[str, Any]:
    """Return what ``info["terminal"]`` says of a screen."""
    return {
        "running": result.running,
        "cursor": list(result.cursor),
        "exit_code": result.exit_code,
        "workdir": result.workdir,
        "restarted": result.restarted,
    }


def verdict_info(verdict: Verdict) -> dict[str, Any]:
    """Return what ``info["verifier"]`` says; the output of the tests is for people, never for the agent."""
    tests = [
        {"name": test.name, "passed": test.passed, "weight": test.weight, "message": test.message}
        for test in verdict.tests[:_MOST_TESTS]
    ]
    return {
        "passed": verdict.passed,
        "score": verdict.score if math.isfinite(verdict.score) else 0.0,
        "tests": tests,
        "tests_passed": sum(test.passed for test in verdict.tests),
        "tests_total": len(verdict.tests),
        "rewards": dict(verdict.rewards),
        "problem": verdict.problem,
        "blame": verdict.blame,
        "detail": verdict.detail,
        "output": verdict.output[-_MOST_CHARACTERS:],
        **verdict.info,
    }


def messages_of(action: Action, answer: str) -> list[dict[str, Any]]:
    """Return what a chat appends after a response with native calls: an answer under the id of each."""
    one = "Not done: each response does one thing, and this was not the first call of it."
    others = [{"role": "tool", "tool_call_id": call_id, "content": one} for call_id in action.other_call_ids]
    return [{"role": "tool", "tool_call_id": action.call_id, "content": answer}, *others]
