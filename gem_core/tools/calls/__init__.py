"""The forms in which models are trained to call tools: a table, and one small reader for each form.

``FORMATS`` is the table. ``format_calls`` returns calls that begin with a mark, ``bare_call`` those without one,
``json_call`` the form of the instructions. All take any text, in time that grows with its length alone, and raise
nothing.
"""

from __future__ import annotations

from gem_core.tools.calls.bare import bare_call
from gem_core.tools.calls.found import ParsedCall, tool_call, tool_taking
from gem_core.tools.calls.table import FORMATS, Format, format_call, format_calls, without_end_tokens

__all__ = [
    "FORMATS",
    "Format",
    "ParsedCall",
    "bare_call",
    "format_call",
    "format_calls",
    "tool_call",
    "tool_taking",
    "without_end_tokens",
]
