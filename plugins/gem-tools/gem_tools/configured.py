"""A tool that is made of options: what the agent is told of it may be replaced, and another process makes it again."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, Self

from gem_core.errors import ArgumentError
from gem_core.tools import Tool


class ConfiguredTool(Tool):
    """A tool with the options ``name``, ``description`` and ``instructions``."""

    _make: Callable[..., Any]
    _options: Mapping[str, Any] = {}

    def configured(self, make: Callable[..., Any], options: Mapping[str, Any]) -> Self:
        """Note how the tool was made, and what the agent is told of it.

        Args:
            make: Function that makes the tool again from its options.
            options: All of them; without ``description`` the tool keeps its own.

        Raises:
            ArgumentError: A name, description or line of instructions that is not one line of text.
        """
        for option in ("name", "description", "instructions"):
            text = options.get(option)
            if text is not None and (not isinstance(text, str) or not text.strip() or "\n" in text):
                raise ArgumentError(f"{option} must be one line of text, not {text!r}")
        self._make = make
        self._options = {option: value for option, value in options.items() if value is not None}
        self.name = options["name"]
        self.description = options["description"] or self.description
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return functools.partial(self._make, **self._options), ()

    def instructions(self) -> str:
        """Return the line that explains the tool to an agent."""
        return self._options.get("instructions") or super().instructions()
