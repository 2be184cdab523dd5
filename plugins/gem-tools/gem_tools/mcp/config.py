"""Which servers there are: from keywords, or from the ``mcpServers`` file that other clients read as well."""

from __future__ import annotations

import contextlib
import difflib
import functools
import json
import os
import re
import shlex
import shutil
import urllib.parse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from gem_core.errors import ArgumentError

STDIO, HTTP, SSE = "stdio", "http", "sse"
EPISODE_DIR = "{episode_dir}"
"""Stands for a folder that each session has for itself."""

_FORMS = {STDIO: STDIO, HTTP: HTTP, SSE: SSE, "streamable-http": HTTP, "streamable_http": HTTP, "streamableHttp": HTTP}
_FORMS["local"] = STDIO
"""Clients' names of transports."""

_VARIABLE = re.compile(r"\$\{([^{}]*)\}")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)

_LONG_PART = 24
"""Parts of an address's path that are so long are keys: some services have them there."""

_SHORTEST_SECRET = 6
"""What is shorter is no secret, and to replace it would garble words."""


@dataclass(frozen=True)
class Server:
    """How one server is started (``stdio``), or where it is (``http``, which is streamable HTTP, or ``sse``).

    ``connect_s`` limits its start and first answer, and the list of its tools; ``call_s`` limits a call.
    """

    name: str
    command: str = ""
    args: tuple[str, ...] = ()
    env: tuple[tuple[str, str], ...] = ()
    cwd: str | None = None
    url: str = ""
    headers: tuple[tuple[str, str], ...] = ()
    transport: str = STDIO
    connect_s: float = 30.0
    call_s: float = 60.0

    def __repr__(self) -> str:
        # Arguments, variables, headers and the rest of an address may hold secrets.
        return f"Server({self.name!r}, {self.place!r})"

    def in_folder(self, folder: str) -> Server:
        """Return the server with a folder in the place of ``{episode_dir}``."""
        args = tuple(each.replace(EPISODE_DIR, folder) for each in self.args)
        env = tuple((name, value.replace(EPISODE_DIR, folder)) for name, value in self.env)
        return replace(self, args=args, env=env, cwd=self.cwd and self.cwd.replace(EPISODE_DIR, folder))

    @property
    def place(self) -> str:
        """Where it is, without what may be secret."""
        if self.transport == STDIO:
            return self.command
        parts = urllib.parse.urlsplit(self.url)
        path = "/".join("…" if len(part) >= _LONG_PART else part for part in parts.path.split("/"))
        return f"{parts.scheme}://{parts.hostname}{f':{parts.port}' if parts.port else ''}{path}"

    def without_secrets(self, text: str) -> str:
        """Return what a server said, without the secrets that it was given."""
        for secret in self._secrets:
            text = text.replace(secret, "***")
        return text

    @functools.cached_property
    def _secrets(self) -> list[str]:
        parts = urllib.parse.urlsplit(self.url)
        given = [value for _, value in (*self.env, *self.headers)]
        given += [word for _, value in self.headers for word in value.split()]  # as in "Bearer TOKEN"
        given += [value for _, value in urllib.parse.parse_qsl(parts.query)]
        given += [part for part in parts.path.split("/") if len(part) >= _LONG_PART]
        given += [urllib.parse.unquote(parts.password)] if parts.password else []
        return sorted({text for text in given if len(text) >= _SHORTEST_SECRET}, key=len, reverse=True)


def _expanded(text: object, info: pydantic.ValidationInfo) -> object:
    """Replace variables in a text of a file; the context holds the file's folder."""
    folder = info.context["folder"] if info.context else None
    if isinstance(text, str) and folder is not None:
        return _VARIABLE.sub(lambda match: _variable(match[1], folder), text)
    return text


def _variable(variable: str, folder: Path) -> str:
    if variable in ("userHome", "workspaceFolder"):
        return str(folder if variable == "workspaceFolder" else Path.home())
    if variable.startswith("input:"):
        raise ValueError(f"asks the user for ${{{variable}}}; use a variable of the environment, as in ${{NAME}}")
    name, has_default, default = variable.removeprefix("env:").partition(":-")
    if not _NAME.fullmatch(name):
        return f"${{{variable}}}"  # for the shell, or the server, to make something of
    value = os.environ.get(name)
    if has_default:
        return value or default
    if value is None:
        raise ValueError(f"needs the environment variable {name}, which is not set")
    return value


_Text = Annotated[str, pydantic.BeforeValidator(_expanded)]


class _Entry(pydantic.BaseModel):
    """One server in a file, as Claude Desktop, Cursor and VS Code write it."""

    # What clients keep there for themselves is nothing to us. Numbers stand for texts, as where a shell reads them.
    model_config = pydantic.ConfigDict(extra="allow", coerce_numbers_to_str=True)

    command: _Text | None = None
    args: list[_Text] = []
    env: dict[str, _Text] = {}
    cwd: _Text | None = None
    url: _Text | None = None
    headers: dict[str, _Text] = {}
    transport: Literal[tuple(_FORMS)] | None = pydantic.Field(  # type: ignore[valid-type]
        None, validation_alias=pydantic.AliasChoices("type", "transport")
    )
    disabled: pydantic.StrictBool = False
    enabled: pydantic.StrictBool = True

    def server(self, name: str, folder: Path | None) -> Server:
        """Return the server; raise a ValueError where keys do not go together, or one is misspelt."""
        for key in self.model_extra or {}:
            if near := difflib.get_close_matches(key, [*type(self).model_fields, "type"], n=1, cutoff=0.8):
                raise ValueError(f"key {key!r}: is not one of a server's; did you mean {near[0]!r}?")
        if (self.command is None) == (self.url is None):
            has = "neither a 'command' nor a 'url'" if self.url is None else "both a 'command' and a 'url'"
            raise ValueError(f"has {has}; a server is either started or reached")
        transport = None if self.transport is None else _FORMS[self.transport]
        if transport is not None and (transport == STDIO) == (self.command is None):
            other = "url" if self.command is None else "command"
            raise ValueError(f"key 'type': is {self.transport!r}, which does not go with a {other!r}")
        if self.url is not None:
            parts = _address(self.url)
            sse = parts.path.rstrip("/").endswith("/sse")
            headers = tuple(self.headers.items())
            name = name or parts.netloc.rpartition("@")[2]
            return Server(name, url=self.url, headers=headers, transport=transport or (SSE if sse else HTTP))
        program, *first = _words(self.command or "")
        cwd = self.cwd
        if cwd is not None and folder is not None and not cwd.startswith(EPISODE_DIR):
            cwd = str(folder / Path(cwd).expanduser())
        args, env = (*first, *self.args), tuple(self.env.items())
        return Server(name or Path(program).name, program, args=args, env=env, cwd=cwd)


def _address(url: str) -> urllib.parse.SplitResult:
    with contextlib.suppress(ValueError):
        parts = urllib.parse.urlsplit(url)
        if parts.scheme in ("http", "https") and parts.hostname and parts.port != 0 and not re.search(r"\s", url):
            return parts
    raise ValueError("key 'url': must look like 'http://localhost:8000/mcp'")


def _words(command: str) -> list[str]:
    """Return a program, and its arguments where a whole command line was given in its place."""
    path = os.path.expanduser(command)
    if not path.strip():
        raise ValueError("key 'command': is empty")
    if not re.search(r"\s", path) or shutil.which(path) is not None:
        return [path]
    with contextlib.suppress(ValueError):
        return [os.path.expanduser(word) for word in shlex.split(command)] or [path]
    return [path]


def from_keywords(options: Mapping[str, Any], name: str = "") -> Server:
    """Return the server that the tool's keywords describe; values are taken as they are, without variables."""
    entry = {key: str(value) if key == "cwd" else value for key, value in options.items() if value is not None}
    return _server("the tool 'mcp'", name, entry, None)


def read_config(config: str | os.PathLike[str] | Mapping[str, Any]) -> list[Server]:
    """Return the servers of an ``mcpServers`` file, or of a mapping that has its form, in order.

    Read as Claude Desktop, Cursor and VS Code write it: ``{"mcpServers": {name: {…}}}`` (VS Code: ``"servers"``), with
    ``command``, ``args``, ``env``, ``cwd``, or ``url`` and ``headers``, ``type`` or ``transport``, and ``disabled``.
    ``${NAME}``, ``${env:NAME}`` and ``${NAME:-default}`` stand for environment variables, ``${workspaceFolder}`` for
    the file's folder, ``${userHome}`` for the user's and ``{episode_dir}`` for one of the episode's own. Keys that only
    matter to other clients are ignored. An ArgumentError names the file, the server and the key.
    """
    if isinstance(config, Mapping):
        return _servers("the configuration", config, Path.cwd())
    path = Path(config).expanduser()
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ArgumentError(f"the MCP configuration {path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"the MCP configuration {path} is not JSON: {error}") from error
    return _servers(str(path), content, path.absolute().parent)


def _servers(origin: str, content: object, folder: Path) -> list[Server]:
    found = content if isinstance(content, Mapping) else {}
    entries = found.get("mcpServers", found.get("servers"))
    if not isinstance(entries, Mapping):
        raise ArgumentError(f'{origin} must hold {{"mcpServers": {{"a name": {{"command": …}}}}}}, and does not')
    servers = [
        _server(origin, str(name), entry, folder)
        for name, entry in entries.items()
        if not isinstance(entry, Mapping) or (entry.get("disabled") is not True and entry.get("enabled") is not False)
    ]
    if not servers:
        raise ArgumentError(f"{origin} names no server: its 'mcpServers' is empty, or all are disabled")
    return servers


def _server(origin: str, name: str, entry: object, folder: Path | None) -> Server:
    where = f"{origin}: server {name!r}" if folder is not None else origin
    if not isinstance(entry, Mapping):
        raise ArgumentError(f'{where}: must be an object, as in {{"command": …}}')
    try:
        return _Entry.model_validate(entry, context={"folder": folder}).server(name, folder)
    except pydantic.ValidationError as error:
        # Never what was found there: it may be a password.
        first = error.errors(include_input=False, include_url=False)[0]
        place = f"key {'.'.join(map(str, first['loc']))!r}: " if first["loc"] else ""
        raise ArgumentError(f"{where}: {place}{first['msg'].removeprefix('Value error, ')}") from None
    except ValueError as error:
        raise ArgumentError(f"{where}: {error}") from None
