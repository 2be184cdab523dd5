"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, WrapperSpec, hookimpl

_COMMANDS = {
    "eval": ("running.command", "Score models on suites, with intervals, and record the run."),
    "show": ("show.command", "Show recorded episodes: a list, one of them, or a page."),
    "view": ("viewing.command", "Look at runs in the browser: scores, a table of episodes, and each of them."),
    "audit": ("auditing.command", "Check environments: gold answers, exploits, leaks, duplicates."),
    "compare": (
        "comparing.command",
        "Compare runs, paired by row: differences with intervals, tests, and what flipped.",
    ),
    "score": ("scoring.command", "Grade the episodes of a run again, without a model."),
    "replay": ("replaying.command", "Replay a recorded episode, and go on from any of its turns."),
    "report": ("reporting.command", "Write the scores of runs, with intervals and plots, as one page."),
    "export": ("exporting.command", "Write runs as CSV, JSON lines, or logs of inspect_ai."),
}
_WRAPPERS = {
    "tool_429": ("tool_faults:Tool429", "Answer some calls of tools with HTTP status 429."),
    "tool_timeout": ("tool_faults:ToolTimeout", "Answer some calls of tools as if they had run out of time."),
    "polite": ("wording:Polite", "Put polite sentences around the task."),
    "typos": ("wording:Typos", "Misspell some words of the task."),
}


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands for runs, recorded episodes and audits."""
    return [
        CommandSpec(name=name, entry_point=f"gem_eval.{module}:command", summary=summary)
        for name, (module, summary) in _COMMANDS.items()
    ]


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """What disturbs an agent, by seed."""
    return [
        WrapperSpec(name=name, entry_point=f"gem_eval.robustness.{place}", summary=summary)
        for name, (place, summary) in _WRAPPERS.items()
    ]
