"""The public names, which are imported on first use."""

from .calls import (
    CallReader as CallReader,
    described_call as described_call,
    format_calls as format_calls,
    json_at as json_at,
    json_call as json_call,
    native_calls as native_calls,
    unknown_tool as unknown_tool,
)
from .env import ToolEnv as ToolEnv, find_tool_env as find_tool_env
from .tool import (
    CALL_CLOSE as CALL_CLOSE,
    CALL_OPEN as CALL_OPEN,
    DescribedTool as DescribedTool,
    Tool as Tool,
    ToolCall as ToolCall,
    ToolResult as ToolResult,
)
