"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, ToolSpec, WrapperSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands for runs, recorded episodes and audits."""
    return [
        CommandSpec(
            name="eval",
            entry_point="gem_eval.running.command:command",
            summary="Score models on suites, with intervals, and record the run.",
        ),
        CommandSpec(
            name="show",
            entry_point="gem_eval.show.command:command",
            summary="Show recorded episodes: a list, one of them, two compared, or a page.",
        ),
        CommandSpec(
            name="view",
            entry_point="gem_eval.viewing.command:command",
            summary="Look at runs in the browser: scores, a table of episodes, and each of them.",
        ),
        CommandSpec(
            name="audit",
            entry_point="gem_eval.auditing.command:command",
            summary="Check environments: gold answers, exploits, leaks, duplicates.",
        ),
        CommandSpec(
            name="compare",
            entry_point="gem_eval.comparing.command:command",
            summary="Compare runs, paired by row: differences with intervals, tests, and what flipped.",
        ),
        CommandSpec(
            name="score",
            entry_point="gem_eval.scoring.command:command",
            summary="Grade the episodes of a run again, without a model.",
        ),
        CommandSpec(
            name="replay",
            entry_point="gem_eval.replaying.command:command",
            summary="Replay a recorded episode, and go on from any of its turns.",
        ),
        CommandSpec(
            name="report",
            entry_point="gem_eval.reporting.command:command",
            summary="Write the scores of runs, with intervals and plots, as one page.",
        ),
        CommandSpec(
            name="export",
            entry_point="gem_eval.exporting.command:command",
            summary="Write runs as CSV, Parquet, JSON lines, or logs of inspect_ai.",
        ),
    ]


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """What disturbs an agent, by seed."""
    room = "gem_eval.robustness"
    return [
        WrapperSpec(
            name="tool_429",
            entry_point=f"{room}.tool_faults:Tool429",
            summary="Answer some calls of tools with HTTP status 429.",
        ),
        WrapperSpec(
            name="tool_timeout",
            entry_point=f"{room}.tool_faults:ToolTimeout",
            summary="Answer some calls of tools as if they had run out of time.",
        ),
        WrapperSpec(
            name="cut_outputs",
            entry_point=f"{room}.cut_outputs:CutOutputs",
            summary="Cut off some outputs of tools and of the task.",
        ),
        WrapperSpec(
            name="renamed_parameters",
            entry_point=f"{room}.renamed_parameters:RenamedParameters",
            summary="Give the parameters of tools other names.",
        ),
        WrapperSpec(
            name="paraphrase",
            entry_point=f"{room}.wording:Paraphrase",
            summary="Say the task in other words of the same meaning.",
        ),
        WrapperSpec(
            name="typos",
            entry_point=f"{room}.wording:Typos",
            summary="Misspell some words of the task.",
        ),
    ]


@hookimpl
def gem_register_tools() -> Iterable[ToolSpec]:
    """Tools that only distract."""
    return [
        ToolSpec(
            name="distractor_tools",
            entry_point="gem_eval.robustness.distractors:make_distractors",
            summary="Plausible tools that help with no task.",
        )
    ]
