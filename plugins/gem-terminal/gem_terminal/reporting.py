"""What an agent reads beside the output of its commands, and what ``info`` says: plain JSON, and bounded."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_terminal.actions import Action
    from gem_terminal.shell import CommandResult, ScreenResult
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verdict import Verdict

TOO_LATE = "Your time is over: this was not done any more."
_MOST_TESTS = 1_000
_MOST_CHARACTERS = 4_000


def command_info(result: CommandResult) -> dict[str, Any]:
    """Return what ``info["terminal"]`` says of a command."""
    told = ("exit_code", "timed_out", "workdir", "dropped", "restarted", "waiting")
    return {name: getattr(result, name) for name in told}


def screen_info(result: ScreenResult) -> dict[str, Any]:
    """Return what ``info["terminal"]`` says of a screen."""
    told = ("running", "exit_code", "workdir", "restarted")
    return {"cursor": list(result.cursor), **{name: getattr(result, name) for name in told}}


def verdict_info(verdict: Verdict) -> dict[str, Any]:
    """Return what ``info["verifier"]`` says; the output of the tests is for people, never for the agent."""
    return {
        "passed": verdict.passed,
        "score": verdict.score if math.isfinite(verdict.score) else 0.0,
        "tests": [dataclasses.asdict(test) for test in verdict.tests[:_MOST_TESTS]],
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


def first_words(task: Task, number: int, how: str) -> str:
    """Return the first observation of a step: what to do, and how to act."""
    step = task.steps[number]
    head = "" if len(task.steps) == 1 else f"Step {number + 1} of {len(task.steps)}.\n\n"
    return f"{head}{step.instruction.strip()}\n\n{how.strip()}"


def of_verdict(verdict: Verdict) -> str:
    """Return the end of a step in one line, without the output of the tests."""
    if verdict.problem is not None:
        return "The tests gave no result."
    if verdict.passed:
        return "The tests have passed."
    if verdict.tests:
        return f"{sum(test.passed for test in verdict.tests)} of {len(verdict.tests)} tests have passed."
    return f"The tests have not passed; the score is {verdict.score:g}."


def of_ignored(count: int) -> str:
    """Return the note about the actions of a response behind its first; empty without any."""
    were = "action was" if count == 1 else "actions were"
    return f"[{count} further {were} ignored: each response does one thing.]" if count else ""


def status(workdir: str, turns_left: int | None, seconds_left: float | None) -> str:
    """Return how things stand: the working directory, and what is left of the turns and, where it is shown, of time."""
    parts = [workdir] if workdir else []
    if turns_left is not None:
        parts.append("the last turn" if turns_left == 1 else f"{turns_left} turns left")
    if seconds_left is not None:
        parts.append("less than a minute left" if seconds_left < 60 else f"{int(seconds_left // 60)} min left")
    return f"\n[{' · '.join(parts)}]" if parts else ""
