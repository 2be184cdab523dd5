"""The tool of the fine plugin, beside its environment, since it needs pydantic."""

from gem_core import Tool


class FineTool(Tool):
    """A tool."""


def read_call(opening, tools):
    """Read no call."""
    return None
