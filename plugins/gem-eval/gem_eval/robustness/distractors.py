"""``distractor_tools``: plausible tools that help with no task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pydantic

from gem_core.errors import ArgumentError
from gem_core.tools import Tool, ToolResult
from gem_core.types import Concurrency


class Distractor(Tool):
    """A tool that takes any text and has nothing to tell.

    Args:
        name: Of the tool.
        description: What it is said to do.
        parameters: Name and description of each, all of them text.
        answer: What every call returns.
    """

    concurrency: Concurrency = "inline"

    def __init__(self, name: str, description: str, parameters: Mapping[str, str], answer: str) -> None:
        fields: Any = {each: (str, pydantic.Field(description=told)) for each, told in parameters.items()}
        own = {"name": name, "description": description, "Parameters": pydantic.create_model("Parameters", **fields)}
        vars(self).update(own)
        self._answer = answer

    def call(self, arguments: Any, session: Any) -> ToolResult:
        """Return the answer, which helps nobody."""
        return ToolResult(self._answer, info={"distractor": True})


_TRANSLATED = {"text": "what to translate", "language": "the language wanted"}
_SENT = {"recipient": "who gets it", "message": "what it says"}
_DISTRACTORS = (
    ("weather", "Tells the weather forecast for a city.", {"city": "name of the city"}, "No forecast is available."),
    (
        "translate",
        "Translates a text into another language.",
        _TRANSLATED,
        "No translation is available for this language.",
    ),
    ("calendar", "Lists the appointments of a day.", {"date": "the day, as 2024-05-31"}, "There are no appointments."),
    (
        "exchange_rate",
        "Tells the exchange rate of a currency.",
        {"currency": "its code"},
        "There is no rate for today.",
    ),
    ("news", "Finds the latest news on a topic.", {"topic": "a few words"}, "There is no news on this topic."),
    (
        "send_message",
        "Sends a short message to a colleague.",
        _SENT,
        "The message is in the queue. Nobody has read it.",
    ),
    ("stock_price", "Tells the price of a share.", {"symbol": "its symbol"}, "The exchange is closed."),
    ("reminder", "Sets a reminder.", {"text": "what of", "time": "when, as 17:30"}, "The reminder is set."),
)


def make_distractors(count: int = 4) -> list[Tool]:
    """Return tools that look useful and help with no task.

    Args:
        count: How many, from 1 to 8.

    Raises:
        ArgumentError: There are not so many.
    """
    if type(count) is not int or not 1 <= count <= len(_DISTRACTORS):
        raise ArgumentError(f"count must be a whole number from 1 to {len(_DISTRACTORS)}, not {count!r}")
    return [Distractor(*each) for each in _DISTRACTORS[:count]]
