"""Tools: what one is, how calls are read out of a response, and the wrapper that gives tools to a task."""

from __future__ import annotations

from gem_core.tools.calls import format_calls
from gem_core.tools.calls.reading import CallReader, blank_out, json_call, native_calls, spoken, thinking_blocks
from gem_core.tools.env import ToolEnv, find_tool_env
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, ToolResult

__all__ = [
    "CALL_CLOSE",
    "CALL_OPEN",
    "CallReader",
    "Tool",
    "ToolCall",
    "ToolEnv",
    "ToolResult",
    "blank_out",
    "find_tool_env",
    "format_calls",
    "json_call",
    "native_calls",
    "spoken",
    "thinking_blocks",
]
