"""Tools: what one is, how calls are read out of a response, and the wrapper that gives tools to a task."""

from __future__ import annotations

from gem_core.parsing import mask, thinking_blocks, visible_text
from gem_core.tools.calls import (
    CallReader,
    described_call,
    format_calls,
    json_at,
    json_call,
    native_calls,
    unknown_tool,
)
from gem_core.tools.env import ToolEnv, find_tool_env
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, DescribedTool, Tool, ToolCall, ToolResult

__all__ = [
    "CALL_CLOSE",
    "CALL_OPEN",
    "CallReader",
    "DescribedTool",
    "Tool",
    "ToolCall",
    "ToolEnv",
    "ToolResult",
    "described_call",
    "find_tool_env",
    "format_calls",
    "json_at",
    "json_call",
    "mask",
    "native_calls",
    "thinking_blocks",
    "unknown_tool",
    "visible_text",
]
