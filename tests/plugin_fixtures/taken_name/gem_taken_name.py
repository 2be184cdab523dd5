"""Gives a tool the name of another plugin's wrapper."""

from gem_core import ToolSpec, hookimpl


@hookimpl
def gem_register_tools():
    """Offer a tool; tools and wrappers share one space of names."""
    return [ToolSpec(name="fine_wrapper", entry_point="gem_taken_name:Tool")]
