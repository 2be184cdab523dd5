"""What the tests of the tool ``mcp`` share."""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gem_core as gem
from gem_core.data import DatasetEnv
from gem_core.tools import ToolEnv

BAD_SERVER = str(Path(__file__).with_name("mcp_bad_server.py"))
PATIENCE_S = 120.0
"""How long a test waits for what must come; none waits for it to pass."""


QUESTION = "mcptest:Question-v0"


def question() -> DatasetEnv:
    """Return a task that asks one question."""
    return DatasetEnv([{"question": "?", "answer": "42"}])


gem.register(QUESTION, question)


def bad(*ways: str, **options: Any) -> tuple[str, dict[str, Any]]:
    """Return the choice of the tools of a server that misbehaves in some ways."""
    return "mcp", {"command": sys.executable, "args": ["-S", BAD_SERVER, *ways], "server_name": "bad", **options}


def around(*tools: Any, **options: Any) -> ToolEnv:
    """Return a task with tools, started."""
    env = ToolEnv(question(), list(tools), max_tool_uses=None, **options)
    env.reset(seed=0)
    return env


def action(name: str, arguments: Mapping[str, Any]) -> str:
    """Return a call as an agent writes it."""
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


def step(env: Any, name: str, /, **arguments: Any) -> tuple[Any, dict[str, Any]]:
    """Call a tool; return what came back, without the frame around it, and ``info["tool"]``."""
    observation, *_, info = env.step(action(name, arguments))
    if isinstance(observation, str):
        observation = observation.partition("\n")[2].partition("\nYou may call a tool again")[0]
    return observation, info["tool"]


def running(pid: int) -> bool:
    """Tell whether a process runs; one that has ended and was not collected yet does not."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            return file.read().rpartition(b")")[2].split()[0] not in (b"Z", b"X")
    except OSError:
        return False


def wait_until_gone(pids: Iterable[int]) -> None:
    """Wait until none of some processes runs.

    Raises:
        TimeoutError: Some still run.
    """
    pids = list(pids)
    deadline = time.monotonic() + PATIENCE_S
    while left := [pid for pid in pids if running(pid)]:
        if time.monotonic() > deadline:
            raise TimeoutError(f"still running: {left}")
        time.sleep(0.01)


def servers_of(pid: int | None = None) -> list[int]:
    """Return the servers that a process, by default this one, has as children."""
    found = []
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                stat = Path("/proc", name, "stat").read_bytes().rpartition(b")")[2].split()
                ours = int(stat[1]) == (pid or os.getpid()) and stat[0] != b"Z"
                command = Path("/proc", name, "cmdline").read_bytes().replace(b"gem-mcpmark", b"")  # its PostgreSQL
                if ours and b"mcp" in command:
                    found.append(int(name))
            except OSError:
                continue
    return found


def wait_until_no_server_runs() -> None:
    """Wait until none of this process's servers runs; a shared one ends when the last who used it is collected.

    Raises:
        TimeoutError: Some still run.
    """
    gc.collect()
    wait_until_gone(servers_of())
