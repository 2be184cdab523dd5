"""``renamed_parameters``: the same tools, whose parameters have other names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pydantic

from gem_core.env import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.tools import Tool, ToolCall
from gem_eval.robustness.changed_tool import ChangedTool
from gem_eval.robustness.perturbation import tool_env_in

_OTHER_NAMES = {
    "code": "source",
    "command": "instruction_line",
    "content": "body",
    "expression": "formula",
    "id": "identifier",
    "name": "label",
    "path": "location",
    "query": "search_text",
    "sql": "statement",
    "text": "content",
    "timeout": "time_limit",
    "url": "address",
}
"""Names that an author of a tool could have given instead; any other gets ``_value`` behind it."""


class RenamedParameters(Wrapper):
    """Renames the parameters of all tools, and maps the new names back when a tool is called.

    Schemas, the text that explains the tools, and errors about arguments have the new names; an old name is answered
    with an error that lists them. Tags and fenced blocks, which name no parameter, work as before. A tool's own words
    of explanation, where it has some, give way to those that are made from its schema.

    Args:
        env: An environment with tools.

    Raises:
        ArgumentError: There are no tools inside.
    """

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env)
        tool_env_in(env, type(self).__name__).change_tools(_RenamedTool)


class _RenamedTool(ChangedTool):
    """A tool whose parameters have other names."""

    def __init__(self, tool: Tool) -> None:
        super().__init__(tool)
        properties = tool.parameters_schema().get("properties")
        self._new = _new_names(list(properties) if isinstance(properties, Mapping) else [])
        self._old = {new: old for old, new in self._new.items()}

    def parameters_schema(self) -> dict[str, Any]:
        schema = super().parameters_schema()
        if isinstance(schema.get("properties"), Mapping):
            schema["properties"] = {self._new[name]: _untitled(each) for name, each in schema["properties"].items()}
        if isinstance(schema.get("required"), list):
            schema["required"] = [self._new.get(name, name) for name in schema["required"]]
        return schema

    def validate(self, arguments: Mapping[str, Any]) -> Any:
        for name in arguments:
            if name in self._new and name not in self._old:
                raise ArgumentError(f"there is no parameter {name!r}; {self._listed()}")
        try:
            return super().validate({self._old.get(name, name): value for name, value in arguments.items()})
        except pydantic.ValidationError as error:
            problems = [(".".join(map(str, self._renamed(item["loc"]))), item["msg"]) for item in error.errors()[:10]]
            raise ArgumentError("; ".join(f"{where or 'arguments'}: {what}" for where, what in problems)) from None
        except ArgumentError as error:
            raise ArgumentError(f"{error}. {self._listed().capitalize()}") from None

    def parse(self, action: str, *, fences: bool = True) -> ToolCall | None:
        call = super().parse(action, fences=fences)
        if call is None:
            return None
        return replace(call, arguments={self._new.get(name, name): value for name, value in call.arguments.items()})

    # Those of the tool itself may name its parameters.
    schema, instructions, hints = Tool.schema, Tool.instructions, Tool.hints

    def _renamed(self, where: tuple[int | str, ...]) -> tuple[int | str, ...]:
        return (self._new.get(str(where[0]), where[0]), *where[1:]) if where else where

    def _listed(self) -> str:
        return f"its parameters are {', '.join(self._old)}" if self._old else "it has no parameters"


def _new_names(names: list[str]) -> dict[str, str]:
    """Return the new name of each parameter; no two are the same, and none is an old name."""
    new: dict[str, str] = {}
    for name in names:
        other = _OTHER_NAMES.get(name, f"{name}_value")
        while other in names or other in new.values():
            other += "_value"
        new[name] = other
    return new


def _untitled(described: Any) -> Any:
    """Return the schema of a parameter without the title, which pydantic makes of the old name."""
    if not isinstance(described, Mapping):
        return described
    return {key: value for key, value in described.items() if key != "title"}
