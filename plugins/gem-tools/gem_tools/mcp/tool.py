"""The tools themselves: those of servers, those that read a server's resources and prompts, and what makes them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from gem_core.errors import ArgumentError, GemError
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool, ToolResult
from gem_core.types import Concurrency
from gem_tools.mcp.config import STDIO, Server, from_keywords, read_config
from gem_tools.mcp.connection import Limits, ServerFault
from gem_tools.mcp.listing import Listing, Offer, listings
from gem_tools.mcp.messages import shortened
from gem_tools.mcp.names import chosen, tool_names
from gem_tools.mcp.results import Budget, cut, from_call, from_prompt, from_resource
from gem_tools.mcp.schemas import ArgumentChecker
from gem_tools.mcp.sessions import Handle, ServerSession, shared_session

MAX_DESCRIPTION_CHARS = 2000
MAX_SHOWN_SCHEMA_CHARS = 4000
_SESSIONS = ("episode", "shared")


def make_mcp(
    config: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    *,
    command: str | None = None,
    args: Sequence[str] = (),
    env: Mapping[str, str] | None = None,
    cwd: str | os.PathLike[str] | None = None,
    url: str | None = None,
    headers: Mapping[str, str] | None = None,
    transport: str | None = None,
    server_name: str | None = None,
    include: str | Sequence[str] | None = None,
    exclude: str | Sequence[str] | None = None,
    resources: bool = True,
    prompts: bool = True,
    sessions: str = "episode",
    roots: Sequence[str | os.PathLike[str]] = (),
    connect_timeout_s: float = 30.0,
    list_timeout_s: float = 30.0,
    call_timeout_s: float = 60.0,
    max_message_bytes: int = 10_000_000,
    max_chars: int = 20_000,
    max_images: int = 4,
) -> list[Tool]:
    """Return the tools of MCP servers.

    The servers are started, or reached, to ask what they offer; the answer is kept for as long as the process lives.

    Args:
        config: An ``mcpServers`` file as other clients read it, or a mapping of that form. Or, for one server:
        command: Program to start.
        args: Its arguments.
        env: Variables that it gets besides the harmless ones (``HOME``, ``PATH``, ``LANG`` and their like).
        cwd: Folder to start it in.
        url: Address of a server that runs already.
        headers: Sent with every request to it.
        transport: ``"http"`` (streamable HTTP) or ``"sse"``; by default ``"sse"`` for an address that ends so.
        server_name: Its name, before those of its tools where two servers have one of the same name.
        include: Names of the tools to take, by default all; ``*`` and ``?`` are understood.
        exclude: Names of tools to leave out.
        resources: Whether to add ``list_resources`` and ``read_resource`` for a server that has resources.
        prompts: Whether to add ``list_prompts`` and ``get_prompt`` for a server that has prompts.
        sessions: ``"episode"``: each episode has a server process or connection of its own; ``"shared"``: one for the
            whole process.
        roots: Folders that a server is told to work in, where it asks.
        connect_timeout_s: For a server's start and first answer, in seconds.
        list_timeout_s: For its lists, all pages together.
        call_timeout_s: For a call.
        max_message_bytes: Longest answer that is read.
        max_chars: Most characters of a result that the agent is given.
        max_images: Most images of a result that the agent is given.

    Raises:
        ArgumentError: An option, or something in the file, that cannot be right.
        MissingRequirementError: A server's program is not there.
        GemError: A server cannot be reached, or does not speak the protocol.
    """
    options = {name: value for name, value in locals().items() if value is not None}
    single = {"args": args, "env": env, "cwd": cwd, "headers": headers, "transport": transport}
    if config is None and command is None and url is None:
        raise ArgumentError("the tool 'mcp' needs a server: config='servers.json', command='program' or url='http://…'")
    if config is None:
        servers = [from_keywords(command, args, env, cwd, url, headers, transport, server_name)]
    elif command is not None or url is not None or server_name is not None or any(single.values()):
        raise ArgumentError("the tool 'mcp' takes a config, or one server by keywords, and not both")
    else:
        servers = read_config(config)[0]
    if sessions not in _SESSIONS:
        raise ArgumentError(f"sessions must be 'episode' or 'shared', not {sessions!r}")
    limits = _checked(Limits(connect_timeout_s, list_timeout_s, call_timeout_s, max_message_bytes))
    setup = _Setup(
        limits, Budget(max_chars, max_images), sessions == "shared", tuple(os.fspath(root) for root in roots), options
    )
    found = listings(servers, limits, setup.roots)
    offered = [
        (server, name, build)
        for server, listing in zip(servers, found, strict=True)
        for name, build in _offers(server, listing, setup, resources, prompts)
    ]
    names = tool_names([(server.name, name) for server, name, _ in offered])
    kept = chosen(names, include, exclude)
    return [build(name) for name, (_, _, build) in zip(names, offered, strict=True) if name in kept]


@dataclass(frozen=True)
class _Setup:
    """What all tools of one ``make_mcp`` have in common."""

    limits: Limits
    budget: Budget
    shared: bool
    roots: tuple[str, ...]
    options: Mapping[str, Any]


class McpTool(Tool):
    """A tool that asks a server.

    Args:
        name: What the agent calls it by.
        server: Whom it asks.
        setup: Limits, and whether the session is shared.
        description: For the agent.
        schema: JSON Schema of its arguments.
    """

    concurrency: Concurrency = "async"

    def __init__(self, name: str, server: Server, setup: _Setup, description: str, schema: Mapping[str, Any]) -> None:
        self.name = name
        self.server = server
        self.description = _sentence(description) or f"A tool of {server.name}."
        self._setup = setup
        self._schema = schema
        self._checker = ArgumentChecker(schema)
        # A tool of another environment with the same server may share the session of this episode.
        mark = hashlib.sha256(repr((vars(server), setup.limits, setup.roots)).encode("utf-8", "replace")).hexdigest()
        self._session_key = f"mcp:{server.name}:{mark[:12]}"

    def __reduce__(self) -> tuple[Any, ...]:
        # In another process the tools are made again, with connections of their own.
        return _remade, (dict(self._setup.options), self.name)

    @property
    def session_key(self) -> str:
        """The same for all tools of a server, so that an episode has one session with it."""
        return self._session_key

    def parameters_schema(self) -> dict[str, Any]:
        """Return the server's schema of the arguments."""
        schema: dict[str, Any] = json.loads(json.dumps(self._schema, default=str))
        return {"type": "object", "properties": {}, **schema}

    def validate(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments, held to the server's schema.

        Raises:
            ArgumentError: They do not fit.
        """
        return self._checker.check(arguments)

    def instructions(self) -> str:
        """Return a line that tells an agent what the tool does, how to call it, and of what form its arguments are."""
        example = json.dumps({"name": self.name, "arguments": "…"}, ensure_ascii=False).replace('"…"', "{…}")
        how = f"{CALL_OPEN}{example}{CALL_CLOSE}"
        if self.text_parameter is not None:
            how = f"<{self.name}>{self.text_parameter}</{self.name}>"
        schema = json.dumps(_told(self.parameters_schema()), ensure_ascii=False)
        text = f"- {self.name}: {self.description} Call it with {how}; its arguments, as a JSON Schema: {schema}"
        # Also what counts as a line break to some.
        return shortened(text, MAX_DESCRIPTION_CHARS + MAX_SHOWN_SCHEMA_CHARS)

    def hints(self) -> str:
        """Return nothing: all that ``instructions`` tell is in the schema."""
        return ""

    async def open(self) -> Handle:
        """Return this episode's session; it connects at the first call."""
        setup = self._setup
        if setup.shared:
            return Handle(shared_session(self, self.server, setup.limits, setup.roots), shared=True)
        return Handle(ServerSession(self.server, setup.limits, setup.roots), shared=False)

    async def close(self, session: Handle) -> None:
        """Close the session, and end its server, unless it is shared."""
        await session.close()

    async def call(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        """Ask the server; what it answers, or why it does not, is for the agent."""
        info: dict[str, Any] = {"server": self.server.name}
        try:
            result = await self._ask(arguments, session)
        except ServerFault as fault:
            session.restarted()
            if fault.kind not in ("error", "too_long"):
                info["fault"] = f"{fault.kind}: {fault.message}"  # for trainers: a machine failed, not the agent
            return ToolResult(_explained(fault, self.server), failed=True, info=info)
        except GemError as error:
            message = f"The server {self.server.name} cannot be used: {error}. This is no fault of your call."
            return ToolResult(message, failed=True, info={**info, "fault": str(error)})
        content = result.content
        if session.restarted():
            # One that runs elsewhere may have gone on all the time; only the connection is known to be another.
            ours = self.server.transport == STDIO
            name = self.server.name
            event = f"server {name} was restarted" if ours else f"connection to the server {name} was made anew"
            note = f"[The {event} before this call: what the server remembered may be lost.]"
            content = f"{note}\n{content}" if isinstance(content, str) else [{"type": "text", "text": note}, *content]
            info["restarted" if ours else "reconnected"] = True
        return ToolResult(content, failed=result.failed, info={**info, **result.info})

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        raise NotImplementedError


class ServerTool(McpTool):
    """A server's own tool.

    Args:
        name: What the agent calls it by.
        server: Whose it is.
        setup: Limits, and whether the session is shared.
        offer: What the server says of it.
    """

    def __init__(self, name: str, server: Server, setup: _Setup, offer: Offer) -> None:
        super().__init__(name, server, setup, offer.description, offer.schema)
        self.offer = offer

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        params = {"name": self.offer.name, "arguments": arguments}
        result = await session.session.request("tools/call", params, repeatable=self.offer.repeatable)
        if "inputRequests" in result or result.get("resultType") == "input_required":
            text = "The server wants to ask a person something before it goes on, and there is nobody to be asked."
            return ToolResult(text, failed=True, info={"server_tool": self.offer.name})
        content, info = from_call(result, self._setup.budget)
        return ToolResult(content, failed=result.get("isError") is True, info={"server_tool": self.offer.name, **info})


class _Helper(McpTool):
    """A tool of ours for what a server has besides tools."""

    text: str
    properties: ClassVar[Mapping[str, Any]] = {}
    required: tuple[str, ...] = ()

    def __init__(self, name: str, server: Server, setup: _Setup) -> None:
        schema = {"type": "object", "properties": self.properties, "required": list(self.required)}
        super().__init__(name, server, setup, self.text.format(server=server.name), schema)


class ListResources(_Helper):
    """Lists a server's resources."""

    text = "Lists what the server {server} has to read, with the addresses that read_resource takes."

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        found = await session.session.listed("resources/list", "resources")
        lines = [_line(item, "uri") for item in found if isinstance(item, Mapping)]
        try:
            templates = await session.session.listed("resources/templates/list", "resourceTemplates")
        except ServerFault as fault:
            if fault.kind not in ("error", "protocol"):
                raise
            templates = []  # many servers have resources, and not this list
        lines += [f"{_line(item, 'uriTemplate')} (fill in what is in braces)" for item in templates]
        return ToolResult(cut("\n".join(lines) or "There are no resources.", self._setup.budget.max_chars))


class ReadResource(_Helper):
    """Reads a server's resource."""

    text = "Reads a resource of the server {server}."
    properties: ClassVar[Mapping[str, Any]] = {
        "uri": {"type": "string", "description": "its address, as in the list of resources"}
    }
    required = ("uri",)

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        result = await session.session.request("resources/read", {"uri": arguments["uri"]}, repeatable=True)
        return ToolResult(from_resource(result, self._setup.budget))


class ListPrompts(_Helper):
    """Lists a server's prompts."""

    text = "Lists the prompts that the server {server} has prepared, with the arguments that get_prompt takes."

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        found = await session.session.listed("prompts/list", "prompts")
        lines = []
        for item in found:
            if isinstance(item, Mapping):
                wanted = item.get("arguments")
                named = [a for a in wanted if isinstance(a, Mapping)] if isinstance(wanted, list) else []
                names = [f"{a.get('name')}{'' if a.get('required') else '?'}" for a in named]
                lines.append(f"{_line(item, 'name')} (arguments: {shortened(', '.join(names)) or 'none'})")
        return ToolResult(cut("\n".join(lines) or "There are no prompts.", self._setup.budget.max_chars))


class GetPrompt(_Helper):
    """Gets one of a server's prompts."""

    text = "Gets a prompt of the server {server}, with arguments filled in."
    properties: ClassVar[Mapping[str, Any]] = {
        "name": {"type": "string", "description": "its name, as in the list of prompts"},
        "arguments": {"type": "object", "description": "by name", "additionalProperties": {"type": "string"}},
    }
    required = ("name",)

    async def _ask(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        params = {"name": arguments["name"], "arguments": arguments.get("arguments", {})}
        result = await session.session.request("prompts/get", params, repeatable=True)
        return ToolResult(from_prompt(result, self._setup.budget))


_Build = Callable[[str], Tool]


def _offers(
    server: Server, listing: Listing, setup: _Setup, resources: bool, prompts: bool
) -> list[tuple[str, _Build]]:
    """Return names and makers of all tools for one server; its own come first."""

    def own(offer: Offer) -> _Build:
        return lambda name: ServerTool(name, server, setup, offer)

    def helper(kind: type[_Helper]) -> _Build:
        return lambda name: kind(name, server, setup)

    helpers: list[tuple[str, type[_Helper]]] = []
    if resources and listing.resources:
        helpers += [("list_resources", ListResources), ("read_resource", ReadResource)]
    if prompts and listing.prompts:
        helpers += [("list_prompts", ListPrompts), ("get_prompt", GetPrompt)]
    return [(offer.name, own(offer)) for offer in listing.tools] + [(name, helper(kind)) for name, kind in helpers]


def _explained(fault: ServerFault, server: Server) -> str:
    name = server.name
    if fault.kind == "error":
        return f"The server {name} refused the call: {fault.message}"
    if fault.kind == "timeout" and fault.sent:
        return (
            f"The server {name} was too slow: {fault.message}. The call was given up; it may have had its effect all "
            "the same."
        )
    if fault.kind in ("died", "deaf") and fault.sent:
        ours = server.transport == STDIO
        lost = "server" if ours else "connection to the server"
        next_call = "the server is started again" if ours else "a new connection is made"
        return (
            f"The {lost} {name} was lost during the call: {fault.message}. Whether the call had its effect is not "
            f"known. At the next call {next_call}; what the server remembered may be lost."
        )
    if fault.kind == "too_long":
        return f"The server {name} answered with more than can be read: {fault.message}. Ask for less at once."
    if fault.kind == "protocol":
        return f"The server {name} gave an answer that cannot be used: {fault.message}. This is no fault of your call."
    return f"The server {name} cannot be reached: {fault.message}. This is no fault of your call."


def _sentence(text: str) -> str:
    text = shortened(text, MAX_DESCRIPTION_CHARS)
    return text if not text or text[-1] in ".!?…:)" else f"{text}."


def _line(item: Any, key: str) -> str:
    item = item if isinstance(item, Mapping) else {}
    about = [item.get("title") or item.get("name") if key != "name" else None, item.get("description")]
    words = [shortened(word, 300) for word in about if isinstance(word, str) and word.strip()]
    return " — ".join([shortened(str(item.get(key, "?")), 500), *words])


def _told(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema without what says nothing to an agent."""
    return {key: value for key, value in schema.items() if key not in ("$schema", "title", "$id")}


def _checked(limits: Limits) -> Limits:
    for option, value in (
        ("connect_timeout_s", limits.connect_s),
        ("list_timeout_s", limits.list_s),
        ("call_timeout_s", limits.call_s),
    ):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
            raise ArgumentError(f"{option} must be a positive number, not {value!r}")
    if type(limits.max_bytes) is not int or limits.max_bytes < 1000:
        raise ArgumentError(f"max_message_bytes must be a whole number from 1000 up, not {limits.max_bytes!r}")
    return limits


def _remade(options: dict[str, Any], name: str) -> Tool:
    return next(tool for tool in make_mcp(**options) if tool.name == name)
