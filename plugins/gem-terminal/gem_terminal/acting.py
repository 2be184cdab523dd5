"""What an agent is told about acting: in words, and as schemas of tools."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.tools import Tool


class _Described(Tool):
    """A tool that is only described and read; the environment does what it says."""

    def __init__(self, name: str, description: str, properties: Mapping[str, Any], required: Sequence[str]) -> None:
        self.name = name
        self.description = description
        self._schema = {"type": "object", "properties": dict(properties), "required": list(required)}

    def parameters_schema(self) -> dict[str, Any]:
        return copy.deepcopy(self._schema)


TOOLS: Mapping[str, Tool] = {
    tool.name: tool
    for tool in (
        _Described(
            "bash",
            "Runs a command in a persistent shell and returns its output and exit code. The working directory, "
            "variables, functions and background jobs stay from call to call.",
            {
                "command": {"type": "string", "description": "what the shell runs, of one or more lines"},
                "timeout": {"type": "number", "description": "seconds after which the command is killed"},
            },
            ["command"],
        ),
        _Described(
            "keys",
            "Types keys into the terminal, for interactive programs, and returns the screen. Special keys are written "
            "as <Enter>, <Tab>, <Esc>, <Up>, <C-c>, <F1>; no key at all shows the screen.",
            {
                "keys": {"type": "string", "description": "text and special keys, as in :wq<Enter>"},
                "wait": {"type": "number", "description": "seconds to wait for the screen to come to rest"},
            },
            ["keys"],
        ),
        _Described("finish", "Ends the task, and has what is there now verified.", {}, []),
    )
}
"""The three actions as tools, by name."""


def tool_schemas() -> list[dict[str, Any]]:
    """Return the actions as the OpenAI chat API describes functions, for ``info["tools"]``."""
    return [tool.schema() for tool in TOOLS.values()]


def how_to_act_natively(*, timeout_s: float, most_timeout_s: float, columns: int = 120, lines: int = 40) -> str:
    """Return what an agent that is offered the tools natively is told beyond their schemas; see ``how_to_act``."""
    return (
        "You work in a terminal, by calling its tools. Each response does one thing; the first call in it counts. A "
        f"command is killed after {timeout_s:g} seconds; its timeout may be at most {most_timeout_s:g}. The screen has "
        f"{columns}x{lines} characters. What you leave when you call finish is tested."
    )


def how_to_act(*, timeout_s: float, most_timeout_s: float, columns: int = 120, lines: int = 40) -> str:
    """Return what an agent is told about acting.

    Args:
        timeout_s: Seconds that a command may take when it does not say.
        most_timeout_s: Seconds that it may ask for.
        columns: Width of the terminal.
        lines: Height of the terminal.
    """
    return "\n".join(
        [
            "You work in a terminal. Each response does one thing; the first complete action in it counts:",
            "- <bash>command</bash> runs a command, of one or more lines, in a shell that stays open: its working "
            "directory, variables and background jobs live on. You get the output and the exit code. A command is "
            f'killed after {timeout_s:g} seconds; <bash timeout="60"> asks for another limit, of at most '
            f"{most_timeout_s:g}. A fenced block marked bash does the same.",
            f"- <keys>text<Enter></keys> types into the terminal and shows its screen ({columns}x{lines}), for "
            "programs that ask or fill the screen. Nothing is pressed that you do not write: <Enter> <Tab> <Esc> <BS> "
            '<Up> <Down> <Left> <Right> <PageUp> <F1> <C-c> <A-x> <lt> are special keys. <keys wait="10"></keys> only '
            "watches for that many seconds.",
            "- <finish/> ends the task: what you leave is then tested.",
        ]
    )
