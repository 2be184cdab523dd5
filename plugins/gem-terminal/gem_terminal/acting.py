"""What an agent is told about acting: in words, and as schemas of tools."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gem_core.tools import DescribedTool, Tool

if TYPE_CHECKING:
    from gem_terminal.settings import Settings


def _described(name: str, description: str, required: list[str], **properties: tuple[str, str]) -> DescribedTool:
    schema = {key: {"type": kind, "description": words} for key, (kind, words) in properties.items()}
    parameters = {"type": "object", "properties": schema, "required": required}
    fences = ("bash", "sh", "shell") if name == "bash" else ()
    return DescribedTool({"name": name, "description": description, "parameters": parameters}, fences)


TOOLS: Mapping[str, Tool] = {
    tool.name: tool
    for tool in (
        _described(
            "bash",
            "Runs a command in a persistent shell and returns its output and exit code. The working directory, "
            "variables, functions and background jobs stay from call to call.",
            ["command"],
            command=("string", "what the shell runs, of one or more lines"),
            timeout=("number", "seconds after which the command is killed"),
        ),
        _described(
            "keys",
            "Types keys into the terminal, for interactive programs, and returns the screen. Special keys are written "
            "as <Enter>, <Tab>, <Esc>, <Up>, <C-c>, <F1>; no key at all shows the screen.",
            ["keys"],
            keys=("string", "text and special keys, as in :wq<Enter>"),
            wait=("number", "seconds to wait for the screen to come to rest"),
        ),
        _described("finish", "Ends the task, and has what is there now verified.", []),
    )
}
"""The three actions as tools, by name."""


def tool_schemas() -> list[dict[str, Any]]:
    """Return the actions as the OpenAI chat API describes functions, for ``info["tools"]``."""
    return [tool.schema() for tool in TOOLS.values()]


def how_to_act(settings: Settings, agent_s: float, turns: int | None, *, natively: bool = False) -> str:
    """Return what an agent is told about acting, with all limits.

    Args:
        settings: How the episode runs.
        agent_s: Seconds of the agent for this step of the task.
        turns: Responses that it has left; None for no limit.
        natively: Whether the agent is offered the tools by the chat API, so that it needs no forms in text.
    """
    timeout, most_timeout = f"{settings.command_timeout_s:g}", f"{settings.longest_command_s:g}"
    screen, most_malformed = f"{settings.columns}x{settings.lines}", settings.max_malformed
    limits = []
    if turns is not None:
        limits.append(f"{turns} {'turn' if turns == 1 else 'turns'}")
    limits.append(f"{_duration(agent_s)} in all, your thinking included")
    told = [f"You have {' and '.join(limits)}."]
    if settings.malformed_penalty:
        told.append(f"A response that holds no action gets a reward of {settings.malformed_penalty:g}.")
    if most_malformed is not None:
        how_many = "One response" if most_malformed == 1 else f"{most_malformed} responses in a row"
        told.append(f"{how_many} without an action end the task.")
    if natively:
        return " ".join(
            [
                "You work in a terminal, by calling its tools. Each response does one thing; the first call in it "
                f"counts. A command is killed after {timeout} seconds; its timeout may be at most "
                f"{most_timeout}. The screen has {screen} characters. What you leave when you call finish "
                "is tested.",
                *told,
            ]
        )
    return "\n".join(
        [
            "You work in a terminal. Each response does one thing; the first complete action in it counts:",
            "- <bash>command</bash> runs a command, of one or more lines, in a shell that stays open: its working "
            "directory, variables and background jobs live on. You get the output and the exit code. A command is "
            f'killed after {timeout} seconds; <bash timeout="60"> asks for another limit, of at most '
            f"{most_timeout}. A fenced block marked bash does the same.",
            f"- <keys>text<Enter></keys> types into the terminal and shows its screen ({screen}), for "
            "programs that ask or fill the screen. Nothing is pressed that you do not write: <Enter> <Tab> <Esc> <BS> "
            '<Up> <Down> <Left> <Right> <PageUp> <F1> <C-c> <A-x> <lt> are special keys. <keys wait="10"></keys> only '
            "watches for that many seconds.",
            "- <finish/> ends the task: what you leave is then tested.",
            " ".join(told),
        ]
    )


def _duration(seconds: float) -> str:
    if seconds < 120 or seconds % 60:
        return f"{seconds:g} seconds"
    return f"{seconds / 60:g} minutes"
