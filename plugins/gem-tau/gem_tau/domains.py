"""The domains: which tools there are, how they are called and described, and what of a database is hashed."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, get_type_hints

from pydantic import create_model

from gem_tau.airline import AirlineTools
from gem_tau.database import Database
from gem_tau.retail import RetailTools
from gem_tau.sample import SampleTools

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
_WRITES = ("book_", "cancel_", "change_", "exchange_", "modify_", "return_", "send_", "swap_", "update_")
"""How the names of the tools begin that change the database."""


@dataclass(frozen=True)
class Domain:
    """The tools of one kind of shop, and the rules that come with them."""

    name: str
    """``tau-retail``, ``tau2-retail``, ``tau2-airline`` or ``sample``."""

    toolkit: Callable[[Database], object]
    """Takes a database; the result has the tools as methods, and what they raise is what the assistant reads."""

    tools: Mapping[str, Callable[..., Any]]
    """The methods, by name."""

    ends: frozenset[str] = frozenset()
    """Tools that end the conversation."""

    tau2: bool = True
    """Whether hashes and messages are as in tau2-bench, else as in tau-bench."""

    @property
    def writes(self) -> frozenset[str]:
        """Names of the tools that change the database."""
        return frozenset(name for name in self.tools if name.startswith(_WRITES))

    def call(self, database: Database, name: str, arguments: Mapping[str, Any]) -> str:
        """Call a tool, which may change the database, and return what the assistant reads.

        Args:
            database: A fork of the original, which this call may change.
            name: Name of the tool.
            arguments: Its arguments, as the model wrote them; any JSON.
        """
        if name not in self.tools:
            return f"Error: Tool '{name}' not found." if self.tau2 else f"Unknown action {name}"
        if _depth(arguments) > _MAX_DEPTH:
            return f"Error: the arguments are nested more than {_MAX_DEPTH} levels deep"
        kit = self.toolkit(database)
        try:
            result = getattr(kit, name)(**arguments)
            return result if isinstance(result, str) else json.dumps(result)
        except _FAILURES as error:
            # Python's messages about wrong arguments name the function, which has another name in the originals.
            original = f"{type(kit).__name__}.{name}" if self.tau2 else f"{name.title().replace('_', '')}.invoke"
            return f"Error: {error}".replace(f"{self.tools[name].__qualname__}()", f"{original}()")

    def schemas(self) -> list[dict[str, Any]]:
        """Return descriptions of the tools, as chat servers take them, from the methods' type hints."""
        return [_schema(name, method) for name, method in self.tools.items()]


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
    fields: dict[str, Any] = {name: (hint, ...) for name, hint in hints.items() if name != "return"}
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


def _methods(toolkit: type[object], *, without: str = "") -> dict[str, Callable[..., Any]]:
    methods = inspect.getmembers(toolkit, inspect.isfunction)
    return {name: method for name, method in methods if not name.startswith("_") and name != without}


TAU_RETAIL = Domain(
    name="tau-retail",
    toolkit=partial(RetailTools, tau2=False),
    tools=_methods(RetailTools, without="get_item_details"),
    ends=frozenset({"transfer_to_human_agents"}),
    tau2=False,
)
TAU2_RETAIL = Domain("tau2-retail", RetailTools, _methods(RetailTools, without="think"))
TAU2_AIRLINE = Domain("tau2-airline", AirlineTools, _methods(AirlineTools))
SAMPLE = Domain("sample", SampleTools, _methods(SampleTools), ends=frozenset({"hand_over"}))
