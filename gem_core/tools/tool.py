"""``Tool``: the base class of what an agent may call. ``gem_core.tools.env`` puts tools around a task."""

from __future__ import annotations

import copy
import functools
import json
import re
from collections.abc import Awaitable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import pydantic

from gem_core.parsing import extract_code_blocks, unclosed_code_block
from gem_core.types import Concurrency, Observation

CALL_OPEN, CALL_CLOSE = "<tool_call>", "</tool_call>"


@dataclass(frozen=True)
class ToolCall:
    """A call that was found in a response.

    Args:
        name: Name of the tool.
        arguments: By name, not yet validated.
        start: Index in the response where the call begins.
        end: Index after its last character.
        error: Why it cannot be read; None for a complete call.
        id: Under which a native call is answered; None for a call in the text.
        cut: Whether it cannot be read only because the text ends before it is closed, as where the server stopped at
            the closing tag; its arguments are what there is.
    """

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    start: int = 0
    end: int = 0
    error: str | None = None
    id: str | None = None
    cut: bool = False


@dataclass(frozen=True)
class ToolResult:
    """What a tool gives back to the agent.

    Args:
        content: Text or content parts.
        failed: Whether the call did not do what was asked; the agent reads why in ``content``.
        info: More for ``info["tool"]``, plain JSON.
        fault: Why the call failed where that is no fault of the agent, as when a sandbox cannot start: the step is
            truncated, with this as ``info["error"]``.
    """

    content: Observation
    failed: bool = False
    info: Mapping[str, Any] = field(default_factory=dict)
    fault: str | None = None


class Tool:
    """Something that an agent may call.

    A subclass sets the class attributes and overrides ``call``, plain or ``async``::

        class Multiply(Tool):
            name = "multiply"
            description = "Multiplies two numbers."

            class Parameters(pydantic.BaseModel):
                left: float
                right: float

            def call(self, arguments, session):
                return str(arguments.left * arguments.right)

    A tool with one text parameter is also called by a tag, ``<name>…</name>``, or by a fenced block in one of
    ``fences``. State that belongs to an episode is a *session*: override ``open`` and ``close``. One object may serve
    many environments at once, in several threads, so that it keeps nothing of an episode itself.

    What is known only at run time, as the tools of a server are, is set on the instance: ``name``, ``description`` and
    ``fences``. One that has a JSON Schema and no pydantic model overrides ``parameters_schema`` and ``validate``.
    """

    name: str
    description: str = ""
    fences: tuple[str, ...] = ()
    """Languages of fenced blocks that are calls of this tool."""

    concurrency: Concurrency = "thread"
    """What a call needs: ``"inline"`` for microseconds of pure Python, ``"thread"`` when it blocks."""

    class Parameters(pydantic.BaseModel):
        """The arguments of a call; every subclass defines its own."""

    def call(self, arguments: Any, session: Any) -> ToolResult | Observation | Awaitable[ToolResult | Observation]:
        """Do what was asked.

        Args:
            arguments: What ``validate`` returned: a valid instance of ``Parameters``.
            session: What ``open`` returned for this episode.

        Returns:
            A result, or just its content. An exception is shown to the agent as a failed call.
        """
        raise NotImplementedError(f"{type(self).__name__} must define call(self, arguments, session)")

    def open(self) -> Any:
        """Return a new session; called before the first call of an episode. May be a coroutine."""
        return None

    def close(self, session: Any) -> Any:
        """Release a session. May be a coroutine."""
        return None

    @property
    def session_key(self) -> str:
        """Names the session: tools of one environment with the same key share one, which the first of them opens.

        By default the tool's name, so that each has its own.
        """
        return self.name

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self  # one object serves many environments, a fork among them

    def parameters_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the arguments, an object; by default that of ``Parameters``.

        The caller may change what is returned.
        """
        schema = self.Parameters.model_json_schema()
        return {name: value for name, value in schema.items() if name not in ("title", "description")}

    def validate(self, arguments: Mapping[str, Any]) -> Any:
        """Return the arguments as ``call`` takes them; by default an instance of ``Parameters``.

        Args:
            arguments: What the agent wrote, by name: any plain JSON.

        Raises:
            ArgumentError: They do not fit; the agent reads the message. Pydantic's ``ValidationError`` does as well.
        """
        return self.Parameters.model_validate(dict(arguments))

    @functools.cached_property
    def text_parameter(self) -> str | None:
        """The parameter that a tag or a fenced block fills; None if the tool has not exactly one of text."""
        schema = self.parameters_schema()
        properties, required = schema.get("properties"), schema.get("required")
        if not isinstance(properties, Mapping) or not isinstance(required or [], list):
            return None
        names = list(required or properties)
        if len(names) != 1 or not isinstance(names[0], str):
            return None
        return names[0] if _is_free_text(properties.get(names[0])) else None

    def parse(self, action: str, *, fences: bool = True) -> ToolCall | None:
        """Find the first call of this tool in its text forms.

        Args:
            action: The response.
            fences: Whether fenced blocks are calls; not where they are the task's answers.

        Returns:
            The first complete call; else the first that is begun and not complete, with its ``error``; else None.
        """
        parameter = self.text_parameter
        if parameter is None:
            return None
        found = []
        name = rf"\s{{0,9}}+{re.escape(self.name)}\s{{0,9}}+>"
        opening = re.search(f"<{name}", action) if self.name in action else None
        if opening is not None:
            closing = re.compile(rf"<\s{{0,9}}+/{name}").search(action, opening.end())
            content = action[opening.end() : closing.start() if closing else None]
            unclosed = f"<{self.name}> is never closed by </{self.name}>"
            found.append((opening.start(), closing.end() if closing else -1, content, unclosed))
        if fences and self.fences:
            complete = extract_code_blocks(action, *self.fences)
            block = complete[0] if complete else unclosed_code_block(action, *self.fences)
            if block is not None:
                found.append((block.start, block.end, block.code, "the fenced block is never closed"))
        calls = []
        for start, end, content, unclosed in found:
            arguments = {parameter: self.unfenced(content)}
            if end >= 0:
                calls.append(ToolCall(self.name, arguments, start, end))
            elif content.strip():
                calls.append(ToolCall(self.name, arguments, start, len(action), unclosed, cut=True))
            else:
                calls.append(ToolCall(self.name, start=start, error=unclosed))
        return first_call(calls)

    def schema(self) -> dict[str, Any]:
        """Return the tool as the OpenAI chat API describes functions."""
        function = {"name": self.name, "description": self.description, "parameters": self.parameters_schema()}
        return {"type": "function", "function": function}

    def instructions(self) -> str:
        """Return a line that tells an agent how to call this tool in its text; override it for other words."""
        if self.text_parameter is None:
            return self.explained_in_json()
        forms = [f"<{self.name}>{self.text_parameter}</{self.name}>"]
        forms += [f"a fenced block marked {language}" for language in self.fences[:1]]
        return self._explained(" or ".join(forms))

    def hints(self) -> str:
        """Return what ``instructions`` tell beyond the schema, for a model that is offered the schema itself."""
        told, usual = self.instructions(), Tool.instructions(self)
        more = told.removeprefix(usual).strip()
        return f"- {self.name}: {more}" if more and more != told else more

    def explained_in_json(self) -> str:
        """Return the line that tells how to call this tool in JSON, as where its name is a tag of the task's own."""
        properties = self.parameters_schema().get("properties")
        described = properties.items() if isinstance(properties, Mapping) else ()
        arguments = {name: _placeholder(parameter) for name, parameter in described}
        written = json.dumps({"name": self.name, "arguments": arguments}, ensure_ascii=False)
        return self._explained(f"{CALL_OPEN}{written}{CALL_CLOSE}")

    def _explained(self, how: str) -> str:
        description = " ".join(self.description.split())
        end = "" if description.endswith((".", "!", "?")) else "."
        told = f"{description}{end} " if description else ""
        return f"- {self.name}: {told}Call it with {how}"

    def unfenced(self, content: str) -> str:
        """Return what stands in a tag, without the fence of a block that fills it: models write both at once."""
        if not self.fences:
            return content.strip("\r\n")
        around = content.strip()
        blocks = extract_code_blocks(around, "", *self.fences) if around[:3] in ("```", "~~~") else []
        if len(blocks) == 1 and (blocks[0].start, blocks[0].end) == (0, len(around)):
            return blocks[0].code
        return content.strip("\r\n")


def first_call(calls: Iterable[ToolCall | None]) -> ToolCall | None:
    """Return the complete call that begins first; without a complete one, the incomplete one that does."""
    found = [call for call in calls if call is not None]
    complete = [call for call in found if call.error is None]
    return min(complete or found, key=lambda call: call.start, default=None)


def _is_free_text(described: object) -> bool:
    """Tell whether a parameter takes any text, and not a date, a path or one of a few words."""
    if not isinstance(described, Mapping) or described.get("type") != "string":
        return False
    return not {"enum", "const", "format"} & described.keys()


def _placeholder(parameter: object) -> str:
    text = parameter.get("description") if isinstance(parameter, Mapping) else None
    return " ".join(text.split()) if isinstance(text, str) else "…"


class DescribedTool(Tool):
    """A tool that is only described, so that calls of it can be read; whoever reads them does what they say.

    Args:
        function: Its name, description and parameters, as the OpenAI chat API describes functions.
        fences: Languages of fenced blocks that are calls of it.
    """

    def __init__(self, function: Mapping[str, Any], fences: tuple[str, ...] = ()) -> None:
        self.name, self.description, self.fences = function["name"], function.get("description", ""), fences
        self._parameters = function.get("parameters", {})

    def parameters_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the arguments."""
        schema: dict[str, Any] = copy.deepcopy(self._parameters)
        return schema
