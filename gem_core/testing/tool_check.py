"""``check_tool``: tries the promises of a tool, alone and around a task."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.data import DatasetEnv
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.testing.findings import Findings
from gem_core.testing.hostile import hostile_actions
from gem_core.tools.env import ToolEnv
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, Tool

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
_ROWS = ({"question": "What is 1 + 1?", "answer": "2"},)


def check_tool(
    tool: Tool | str | tuple[str, Mapping[str, Any]] | Callable[[], Tool],
    arguments: Mapping[str, Any] | None = None,
    *,
    name: str | None = None,
) -> list[str]:
    """Try everything that a tool promises.

    Args:
        tool: A tool, a class that needs no options, or the name of a registered one, with its options or without.
        arguments: Those of a call that succeeds; without them no call is tried that should.
        name: The tool to try where the registered name stands for several; by default each is tried.

    Returns:
        The promises that were kept, in one sentence each; of several tools, those of one after the other.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        ArgumentError: Arguments without a name if there are several tools, or no tool of that name.
        GemError: The tool cannot be made, as with an unknown name.
    """
    chosen = tool if isinstance(tool, Tool | str | tuple) else tool()
    env = ToolEnv(DatasetEnv(_ROWS), [chosen], max_tool_uses=None)
    try:
        names = list(env.tools) if name is None else [name]
        if any(each not in env.tools for each in names) or (arguments is not None and len(names) != 1):
            raise ArgumentError(f"name one of these tools: {', '.join(env.tools)}; not {name!r}")
        return [kept for each in names for kept in _check_one(env, each, arguments)]
    finally:
        env.close()


def _check_one(env: ToolEnv, name: str, arguments: Mapping[str, Any] | None) -> list[str]:
    findings = Findings(f"tool {name!r}")
    _check_description(findings, env.tools[name])
    env.reset(seed=0)
    if arguments is not None:
        _check_call(findings, env, name, dict(arguments))
    _check_hostile(findings, env, name)
    env.close()
    findings.attempt("Closing twice is harmless.", env.close)
    return findings.result()


def _check_description(findings: Findings, tool: Tool) -> None:
    findings.expect("Its name is one that model servers take.", bool(_NAME.fullmatch(tool.name)), repr(tool.name))
    findings.expect("It has a description.", bool(tool.description.strip()), "an empty one")
    schemas: list[Any] = []
    findings.attempt("Its schema is plain JSON.", lambda: schemas.append(json.loads(json.dumps(tool.schema()))))
    if schemas:
        parameters = schemas[0].get("function", {}).get("parameters")
        is_object = isinstance(parameters, dict) and parameters.get("type") == "object"
        findings.expect("Its parameters are the JSON Schema of an object.", is_object, repr(parameters)[:200])
        findings.expect("Its instructions are one line.", "\n" not in tool.instructions(), tool.instructions())


def _check_call(findings: Findings, env: ToolEnv, name: str, arguments: dict[str, Any]) -> None:
    call = f"{CALL_OPEN}{json.dumps({'name': name, 'arguments': arguments})}{CALL_CLOSE}"
    observation, _, terminated, truncated, info = env.step(call)
    seen = info.get("tool", {}).get("error") or observation
    if not findings.expect("A call succeeds.", not info.get("tool", {}).get("failed", True), seen):
        return
    findings.expect("A call does not end the episode.", not (terminated or truncated), "it did")
    findings.attempt("What a call reports is plain JSON.", lambda: json.dumps(info["tool"], allow_nan=False))
    if all(session is None for session in env._sessions.open.values()):
        return  # nothing is remembered, and what a tool finds outside may differ from call to call
    env.reset(seed=0)
    again = env.step(call)
    findings.expect("A new episode has a new session.", again[0] == observation, "it remembers")
    try:
        other = env.fork()
    except StateNotSupported:
        return
    try:
        first, second = env.step(call), env.step(call)
        findings.expect("A fork has its own session.", other.step(call) == first, "calls of the first one changed it")
        findings.expect("A fork goes on identically.", other.step(call) == second, "another result")
    finally:
        other.close()


def _check_hostile(findings: Findings, env: ToolEnv, name: str) -> None:
    def call_with_anything() -> None:
        for text in hostile_actions(0):
            for action in (
                text,
                f"<{name}>{text}",
                f'{CALL_OPEN}{{"name": "{name}", "arguments": {text}}}{CALL_CLOSE}',
            ):
                env.reset(seed=0)
                env.find_call(action)
        for arguments in ({}, {"no such parameter": 1}, {"": None}):
            env.reset(seed=0)
            env.step(f"{CALL_OPEN}{json.dumps({'name': name, 'arguments': arguments})}{CALL_CLOSE}")

    findings.attempt("Any text is read, and any arguments are answered.", call_with_anything)
