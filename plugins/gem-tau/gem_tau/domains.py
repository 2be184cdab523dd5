"""The domains: which tools there are, how they are called and described, and what of a database is hashed."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_type_hints

from pydantic import create_model

from gem_tau import retail, sample, tau2_airline, tau2_retail
from gem_tau.database import Database

_FAILURES = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    RecursionError,
    SyntaxError,
    TypeError,
    ValueError,
)
"""What a tool may raise on arguments that a model made up."""

_MAX_DEPTH = 20


@dataclass(frozen=True)
class Domain:
    """The tools of one kind of shop, and the rules that come with them."""

    name: str
    """``tau-retail``, ``tau2-retail`` or ``tau2-airline``."""

    tools: Mapping[str, Callable[..., Any]]
    """Name to function of a database and keyword arguments; what it raises is what the assistant reads as an error."""

    writes: frozenset[str]
    """Tools that change the database."""

    ends: frozenset[str]
    """Tools that end the conversation."""

    hashed: Literal["tuples", "json"]
    """What a database's hash is computed from; see ``Digest``."""

    unknown_tool: str
    """What is answered to a call of a tool that does not exist."""

    signature: Callable[[str], str]
    """What the original's messages about wrong arguments call a tool."""

    def call(self, database: Database, name: str, arguments: Mapping[str, Any]) -> str:
        """Call a tool, which may change the database, and return what the assistant reads.

        Args:
            database: A fork of the original, which this call may change.
            name: Name of the tool.
            arguments: Its arguments, as the model wrote them; any JSON.
        """
        tool = self.tools.get(name)
        if tool is None:
            return self.unknown_tool.format(name=name)
        if _depth(arguments) > _MAX_DEPTH:
            return f"Error: the arguments are nested more than {_MAX_DEPTH} levels deep"
        try:
            result = tool(database, **arguments)
            return result if isinstance(result, str) else json.dumps(result)
        except _FAILURES as error:
            return f"Error: {error}".replace(f"{name}()", self.signature(name))

    def schemas(self) -> list[dict[str, Any]]:
        """Return descriptions of the tools, as chat servers take them, from the functions' type hints."""
        return [_schema(name, function) for name, function in self.tools.items()]


def _depth(value: object) -> int:
    """Return how deeply lists and objects are nested; what is deeper than the limit is not looked at."""
    deepest, level = 0, [value]
    while level and deepest <= _MAX_DEPTH:
        level = [
            part
            for each in level
            if isinstance(each, dict | list)
            for part in (each.values() if isinstance(each, dict) else each)
        ]
        deepest += 1
    return deepest


def _schema(name: str, function: Callable[..., Any]) -> dict[str, Any]:
    hints = get_type_hints(function, include_extras=True)
    names = [each.name for each in inspect.signature(function).parameters.values() if each.kind != each.POSITIONAL_ONLY]
    fields: dict[str, Any] = {each: (hints[each], ...) for each in names}
    schema = _without_titles(create_model(name, **fields).model_json_schema())
    description = inspect.getdoc(function) or ""
    return {
        "type": "function",
        "function": {"name": name, "description": " ".join(description.split()), "parameters": schema},
    }


def _without_titles(schema: Any) -> Any:
    """Leave out pydantic's titles, which only say the names again."""
    if isinstance(schema, list):
        return [_without_titles(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: _without_titles(value) for key, value in schema.items() if not (key == "title" and isinstance(value, str))
    }


def _class_name(tool: str) -> str:
    return "".join(word.capitalize() for word in tool.split("_"))


TAU_RETAIL = Domain(
    name="tau-retail",
    tools={tool.__name__: tool for tool in retail.TOOLS},
    writes=retail.WRITES,
    ends=frozenset({"transfer_to_human_agents"}),
    hashed="tuples",
    unknown_tool="Unknown action {name}",
    signature=lambda tool: f"{_class_name(tool)}.invoke()",
)
TAU2_RETAIL = Domain(
    name="tau2-retail",
    tools={tool.__name__: tool for tool in tau2_retail.TOOLS},
    writes=tau2_retail.WRITES,
    ends=frozenset(),
    hashed="json",
    unknown_tool="Error: Tool '{name}' not found.",
    signature=lambda tool: f"RetailTools.{tool}()",
)
TAU2_AIRLINE = Domain(
    name="tau2-airline",
    tools={tool.__name__: tool for tool in tau2_airline.TOOLS},
    writes=tau2_airline.WRITES,
    ends=frozenset(),
    hashed="json",
    unknown_tool="Error: Tool '{name}' not found.",
    signature=lambda tool: f"AirlineTools.{tool}()",
)
SAMPLE = Domain(
    name="sample",
    tools={tool.__name__: tool for tool in sample.TOOLS},
    writes=frozenset({"cancel_order", "change_address", "return_item", "swap_item"}),
    ends=frozenset({"hand_over"}),
    hashed="json",
    unknown_tool="Error: there is no tool {name}",
    signature=lambda tool: f"{tool}()",
)
