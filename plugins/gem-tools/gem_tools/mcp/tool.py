"""The tools of servers, and what makes them."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError, GemError
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool, ToolResult
from gem_core.types import Concurrency
from gem_tools.mcp.config import STDIO, Server, from_keywords, read_config
from gem_tools.mcp.connection import ServerFault
from gem_tools.mcp.listing import Offer, listings
from gem_tools.mcp.names import chosen, tool_names
from gem_tools.mcp.results import from_call
from gem_tools.mcp.sessions import Handle, ServerSession, shared_session
from gem_tools.mcp.text import shortened

MAX_DESCRIPTION_CHARS = 2000
MAX_SHOWN_SCHEMA_CHARS = 4000
MAX_ARGUMENT_BYTES = 5_000_000
MAX_DEPTH = 60


def make_mcp(
    config: str | Path | Mapping[str, Any] | None = None,
    *,
    command: str | None = None,
    args: Sequence[str] = (),
    env: Mapping[str, str] | None = None,
    cwd: str | Path | None = None,
    url: str | None = None,
    headers: Mapping[str, str] | None = None,
    transport: str | None = None,
    server_name: str | None = None,
    include: str | Sequence[str] | None = None,
    exclude: str | Sequence[str] | None = None,
    sessions: str = "episode",
    connect_timeout_s: float = 30.0,
    call_timeout_s: float = 60.0,
    max_chars: int = 20_000,
    max_images: int = 4,
) -> list[Tool]:
    """Return the tools of MCP servers.

    The servers are started, or reached, to ask what they offer; the answer is kept for as long as the process lives.

    Args:
        config: An ``mcpServers`` file as other clients read it, or a mapping of that form. Or, for one server:
        command: Program to start.
        args: Its arguments. In these, in ``env`` and in ``cwd``, ``{episode_dir}`` stands for an empty folder that each
            session has for itself, and that is deleted with it.
        env: Variables that it gets besides the harmless ones (``HOME``, ``PATH``, ``LANG`` and their like).
        cwd: Folder to start it in.
        url: Address of a server that runs already.
        headers: Sent with every request to it.
        transport: ``"http"`` (streamable HTTP) or ``"sse"``; by default ``"sse"`` for an address that ends so.
        server_name: Its name in messages; by default that of its program or host.
        include: Names of the tools to take, by default all; ``*`` and ``?`` are understood.
        exclude: Names of tools to leave out.
        sessions: ``"episode"``: each episode has a server process or connection of its own; ``"shared"``: one for the
            whole process.
        connect_timeout_s: For a server's start and first answer, and for the list of its tools, in seconds.
        call_timeout_s: For a call.
        max_chars: Most characters of a result that the agent is given.
        max_images: Most images of a result that the agent is given.

    Raises:
        ArgumentError: An option, or something in the file, that cannot be right.
        MissingRequirementError: A server's program is not there.
        GemError: A server cannot be reached, or does not speak the protocol.
    """
    options = dict(locals())
    if sessions not in ("episode", "shared"):
        raise ArgumentError(f"sessions must be 'episode' or 'shared', not {sessions!r}")
    single = {"command": command, "args": args or None, "env": env, "cwd": cwd, "url": url, "headers": headers}
    single["transport"] = transport
    if config is None and command is None and url is None:
        raise ArgumentError("the tool 'mcp' needs a server: config='servers.json', command='program' or url='http://…'")
    if config is None:
        servers = [from_keywords(single, server_name or "")]
    elif server_name is not None or any(single.values()):
        raise ArgumentError("the tool 'mcp' takes a config, or one server by keywords, and not both")
    else:
        servers = read_config(config)
    servers = [replace(server, connect_s=connect_timeout_s, call_s=call_timeout_s) for server in servers]
    offered = [
        (server, offer) for server, listing in zip(servers, listings(servers), strict=True) for offer in listing.tools
    ]
    names = tool_names([(server.name, offer.name) for server, offer in offered])
    kept = chosen(names, include, exclude)
    return [
        McpTool(name, server, offer, options)
        for name, (server, offer) in zip(names, offered, strict=True)
        if name in kept
    ]


class McpTool(Tool):
    """A tool that asks a server; the server describes it by ``offer``. The options are those of ``make_mcp``."""

    concurrency: Concurrency = "async"

    def __init__(self, name: str, server: Server, offer: Offer, options: Mapping[str, Any]) -> None:
        self.name = name
        self.server = server
        description = shortened(offer.description, MAX_DESCRIPTION_CHARS) or f"A tool of {server.name}"
        self.description = description if description[-1] in ".!?…:)" else f"{description}."
        self._offer = offer
        self._options = options
        self._shared: ServerSession | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        # In another process the tools are made again, with connections of their own.
        return _remade, (self._options, self.name)

    @property
    def session_key(self) -> str:
        """The same for all tools of a server, so that an episode has one session with it."""
        return f"mcp:{self.server.name}:{hash(self.server)}"

    def parameters_schema(self) -> dict[str, Any]:
        """Return the server's schema of the arguments."""
        return {"type": "object", "properties": {}, **copy.deepcopy(dict(self._offer.schema))}

    def validate(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments, which the server holds to its schema.

        Raises:
            ArgumentError: They cannot be sent: too long, too deep, or not to be written as JSON.
        """
        if _is_deep(arguments, MAX_DEPTH):
            raise ArgumentError(f"They are nested more than {MAX_DEPTH} deep.")
        try:
            length = len(json.dumps(dict(arguments), allow_nan=False, ensure_ascii=False).encode())
        except (TypeError, ValueError) as error:  # also half of a character that takes two
            raise ArgumentError(f"They cannot be written as JSON: {shortened(str(error))}.") from None
        if length > MAX_ARGUMENT_BYTES:
            raise ArgumentError(f"They are over {MAX_ARGUMENT_BYTES:,} bytes long.")
        return dict(arguments)

    def instructions(self) -> str:
        """Return a line that tells an agent what the tool does, how to call it, and of what form its arguments are."""
        how = f'{CALL_OPEN}{{"name": "{self.name}", "arguments": {{…}}}}{CALL_CLOSE}'
        if self.text_parameter is not None:
            how = f"<{self.name}>{self.text_parameter}</{self.name}>"
        # Without what says nothing to an agent.
        told = {key: value for key, value in self.parameters_schema().items() if key not in ("$schema", "title", "$id")}
        schema = json.dumps(told, ensure_ascii=False)
        line = f"- {self.name}: {self.description} Call it with {how}; its arguments, as a JSON Schema: {schema}"
        # Also what counts as a line break to some.
        return shortened(line, MAX_DESCRIPTION_CHARS + MAX_SHOWN_SCHEMA_CHARS)

    def hints(self) -> str:
        """Return nothing: all that ``instructions`` tell is in the schema."""
        return ""

    async def open(self) -> Handle:
        """Return this episode's session; it connects at the first call."""
        if self._options["sessions"] == "episode":
            return Handle(ServerSession(self.server), shared=False)
        self._shared = shared_session(self.server)  # it lives for as long as tools refer to it
        return Handle(self._shared, shared=True)

    async def close(self, session: Handle) -> None:
        """Close the session, and end its server, unless it is shared."""
        await session.close()

    async def call(self, arguments: dict[str, Any], session: Handle) -> ToolResult:
        """Ask the server; what it answers, or why it does not, is for the agent."""
        name = self.server.name
        info: dict[str, Any] = {"server": name}
        try:
            params = {"name": self._offer.name, "arguments": arguments}
            result = await session.session.request("tools/call", params)
        except ServerFault as fault:
            session.restarted()
            if fault.kind in ("protocol", "unreachable", "died"):
                info["fault"] = f"{fault.kind}: {fault}"  # for trainers: a machine failed, not the agent
            return ToolResult(_explained(fault, self.server), failed=True, info=info)
        except GemError as error:
            message = f"The server {name} cannot be used: {error}. This is no fault of your call."
            return ToolResult(message, failed=True, info=info, fault=str(error))
        content, more = from_call(result, self._options["max_chars"], self._options["max_images"])
        failed = result.get("isError") is True
        if "inputRequests" in result or result.get("resultType") == "input_required":
            content = "The server wants to ask a person something before it goes on, and there is nobody to be asked."
            failed = True
        info |= {"server_tool": self._offer.name, **more}
        if session.restarted():
            # One that runs elsewhere may have gone on all the time; only the connection is known to be another.
            ours = self.server.transport == STDIO
            event = f"server {name} was restarted" if ours else f"connection to the server {name} was made anew"
            note = f"[The {event} before this call: what the server remembered may be lost.]"
            content = f"{note}\n{content}" if isinstance(content, str) else [{"type": "text", "text": note}, *content]
            info["restarted" if ours else "reconnected"] = True
        return ToolResult(content, failed=failed, info=info)


def _is_deep(value: object, left: int) -> bool:
    parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    return left < 0 or any(_is_deep(part, left - 1) for part in parts)


def _explained(fault: ServerFault, server: Server) -> str:
    name, no_fault = server.name, "This is no fault of your call."
    ours = server.transport == STDIO
    lost = "server" if ours else "connection to the server"
    then = "the server is started again" if ours else "a new connection is made"
    return {
        "error": f"The server {name} refused the call: {fault}",
        "too_long": f"The server {name} answered with more than can be read: {fault}. Ask for less at once.",
        "protocol": f"The server {name} gave an answer that cannot be used: {fault}. {no_fault}",
        "unreachable": f"The server {name} cannot be reached: {fault}. {no_fault}",
        "timeout": f"The server {name} was too slow: {fault}. The call was given up; it may have had its effect all "
        "the same.",
        "died": f"The {lost} {name} was lost during the call: {fault}. Whether the call had its effect is not known. "
        f"At the next call {then}; what the server remembered may be lost.",
    }[fault.kind]


def _remade(options: Mapping[str, Any], name: str) -> Tool:
    return next(tool for tool in make_mcp(**options) if tool.name == name)
