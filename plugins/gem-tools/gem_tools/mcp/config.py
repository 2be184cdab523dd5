"""Which servers there are: from keywords, or from the ``mcpServers`` file that other clients read as well."""

from __future__ import annotations

import difflib
import functools
import json
import os
import re
import shlex
import shutil
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from gem_core.errors import ArgumentError
from gem_tools.mcp.names import server_name

STDIO, HTTP, SSE = "stdio", "http", "sse"

MAX_FILE_BYTES = 5_000_000
_TRANSPORTS = {
    "stdio": STDIO,
    "local": STDIO,
    "http": HTTP,
    "streamable-http": HTTP,
    "streamable_http": HTTP,
    "streamableHttp": HTTP,
    "sse": SSE,
}
_KEYS = ("command", "args", "env", "cwd", "url", "headers", "type", "transport", "disabled")
_FOREIGN = frozenset(
    # What clients keep there for themselves: nothing to us, and not to be taken for a slip of the pen.
    [
        "alwaysAllow",
        "allowedTools",
        "autoApprove",
        "autoStart",
        "description",
        "dev",
        "disabledTools",
        "displayName",
        "enabled",
        "enabledTools",
        "excludeTools",
        "icon",
        "id",
        "includeTools",
        "metadata",
        "name",
        "oauth",
        "timeout",
        "title",
        "trust",
        "version",
    ]
)
_VARIABLE = re.compile(r"\$\{([^{}]*)\}")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)

_LONG_PART = 24
"""Parts of an address's path that are so long are keys: some services have them there."""

_SHORTEST_SECRET = 6
"""What is shorter is no secret, and blotted out it would garble words."""


@dataclass(frozen=True)
class Server:
    """How one server is started, or where it is.

    Args:
        name: Its name in the file, or one of our own; it may become part of the tools' names.
        command: Program to start, for the transport ``stdio``.
        args: Its arguments.
        env: Variables that it gets besides the few that are harmless.
        cwd: Folder that it is started in; None for this process's.
        url: Address, for the transports ``http`` and ``sse``.
        headers: Sent with every request.
        transport: ``"stdio"``, ``"http"`` (streamable HTTP) or ``"sse"``.
    """

    name: str
    command: str = ""
    args: tuple[str, ...] = ()
    env: tuple[tuple[str, str], ...] = ()
    cwd: str | None = None
    url: str = ""
    headers: tuple[tuple[str, str], ...] = ()
    transport: str = STDIO

    def __repr__(self) -> str:
        # Arguments, variables, headers and the rest of an address may hold secrets.
        return f"Server({self.name!r}, {self.place!r})"

    @property
    def place(self) -> str:
        """Where it is, without what may be secret."""
        if self.transport == STDIO:
            return self.command
        parts = urllib.parse.urlsplit(self.url)
        path = "/".join("…" if len(part) >= _LONG_PART else part for part in parts.path.split("/"))
        return f"{parts.scheme}://{parts.hostname}{f':{parts.port}' if parts.port else ''}{path}"

    def blotted(self, text: str) -> str:
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


def from_keywords(
    command: str | None,
    args: Sequence[str],
    env: Mapping[str, str] | None,
    cwd: str | os.PathLike[str] | None,
    url: str | None,
    headers: Mapping[str, str] | None,
    transport: str | None,
    name: str | None,
) -> Server:
    """Return the server that the tool's keywords describe; values are taken as they are, without variables.

    Raises:
        ArgumentError: A keyword that cannot be right.
    """
    entry = {
        "command": command,
        "args": list(args) if isinstance(args, Sequence) and not isinstance(args, str) else args,
        "env": env,
        "cwd": None if cwd is None else os.fspath(cwd),
        "url": url,
        "headers": headers,
        "transport": transport,
    }
    chosen = {key: value for key, value in entry.items() if value is not None and value != []}
    if name is None:
        words = _words(command) if isinstance(command, str) and command.strip() else []
        rest = [word for word in args if isinstance(word, str)] if isinstance(args, Sequence) else []
        name = server_name([*words, *rest], None) if words else server_name([], url)
    return _Reader("the tool 'mcp'", name, lambda text: text, None).server(chosen)


def _words(command: str) -> list[str]:
    """Return a program, and its arguments where a whole command line was given in its place."""
    path = os.path.expanduser(command)
    if not re.search(r"\s", command.strip()) or shutil.which(path) is not None:
        return [path]
    try:
        return [os.path.expanduser(word) for word in shlex.split(command)] or [path]
    except ValueError:
        return [path]


def read_config(config: str | os.PathLike[str] | Mapping[str, Any]) -> tuple[list[Server], list[str]]:
    """Return the servers of an ``mcpServers`` file, or of a mapping that has its form.

    Read as Claude Desktop, Cursor and VS Code write it: ``{"mcpServers": {name: {…}}}`` (VS Code: ``"servers"``), with
    ``command``, ``args``, ``env``, ``cwd``, or ``url`` and ``headers``, ``type`` or ``transport``, and ``disabled``.
    ``${NAME}``, ``${env:NAME}`` and ``${NAME:-default}`` stand for environment variables, ``${workspaceFolder}`` for
    the file's folder and ``${userHome}`` for the user's. Keys that only matter to other clients are left alone.

    Returns:
        The servers in order, and the names of those that are disabled.

    Raises:
        ArgumentError: The message names the file, the server and the key.
    """
    if isinstance(config, Mapping):
        return _servers("the configuration", config, Path.cwd())
    path = Path(config).expanduser()
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ArgumentError(f"{path} is over {MAX_FILE_BYTES // 1_000_000} MB long: not a file of MCP servers")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ArgumentError(f"the MCP configuration {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ArgumentError(f"the MCP configuration {path} is not text in UTF-8") from error
    except json.JSONDecodeError as error:
        raise ArgumentError(
            f"the MCP configuration {path} is not JSON: line {error.lineno}, column {error.colno}: {error.msg}"
        ) from error
    except (RecursionError, ValueError) as error:
        raise ArgumentError(f"the MCP configuration {path} is not JSON of a sensible form") from error
    return _servers(str(path), content, path.absolute().parent)


def _servers(origin: str, content: object, folder: Path) -> tuple[list[Server], list[str]]:
    entries = _entries(content)
    if entries is None:
        raise ArgumentError(
            f'{origin} must hold {{"mcpServers": {{"a name": {{"command": …}}}}}}, and has no such object'
        )
    if not entries:
        raise ArgumentError(f"{origin} names no server: its 'mcpServers' is empty")
    servers, disabled = [], []
    for name, entry in entries.items():
        reader = _Reader(origin, str(name), lambda text: text, folder)
        if not isinstance(entry, Mapping):
            reader.wrong(None, f"must be an object, not {_kind(entry)}")
        if reader.flag(entry, "disabled", False) or not reader.flag(entry, "enabled", True):
            disabled.append(str(name))
            continue
        reader.expand = lambda text, reader=reader: reader.expanded(text)  # type: ignore[misc]
        servers.append(reader.server(entry))
    return servers, disabled


def _entries(content: object) -> Mapping[str, Any] | None:
    if not isinstance(content, Mapping):
        return None
    for keys in (("mcpServers",), ("servers",), ("mcp", "servers"), ("mcp", "mcpServers")):
        found: object = content
        for key in keys:
            found = found.get(key) if isinstance(found, Mapping) else None
        if isinstance(found, Mapping):
            return found
    return None


class _Reader:
    """Reads one server's entry; keeps what its errors have to name."""

    def __init__(self, origin: str, name: str, expand: Callable[[str], str], folder: Path | None) -> None:
        self.origin, self.name, self.expand, self.folder = origin, name, expand, folder
        self._key = ""

    def wrong(self, key: str | None, message: str) -> NoReturn:
        where = f"server {self.name!r}" if key is None else f"server {self.name!r}, key {key!r}"
        raise ArgumentError(f"{self.origin}: {where}: {message}")

    def server(self, entry: Mapping[str, Any]) -> Server:
        if not self.name.strip():
            self.wrong(None, "must have a name")
        self._check_keys(entry)
        has_command, has_url = entry.get("command") is not None, entry.get("url") is not None
        if has_command == has_url:
            what = "has both a 'command' and a 'url'" if has_command else "has neither a 'command' nor a 'url'"
            self.wrong(None, f"{what}; a server is either started or reached")
        transport = self._transport(entry, has_url)
        if has_url:
            return Server(self.name, url=self._url(entry), headers=self._pairs(entry, "headers"), transport=transport)
        command = self._text(entry, "command")
        if not command.strip():
            self.wrong("command", "is empty")
        program, *first = _words(command)
        if "cwd" in entry and self.folder is not None:
            cwd: str | None = str(self.folder / Path(self._text(entry, "cwd")).expanduser())
        else:
            cwd = self._text(entry, "cwd") if "cwd" in entry else None
        return Server(
            self.name,
            command=program,
            args=(*first, *self._list(entry, "args")),
            env=self._pairs(entry, "env"),
            cwd=cwd,
            transport=transport,
        )

    def _check_keys(self, entry: Mapping[str, Any]) -> None:
        for key in entry:
            if key in _KEYS or key in _FOREIGN:
                continue
            near = difflib.get_close_matches(str(key), _KEYS, n=1, cutoff=0.75)
            if near:
                self.wrong(str(key), f"is not one of a server's; did you mean {near[0]!r}?")

    def _transport(self, entry: Mapping[str, Any], has_url: bool) -> str:
        key = "type" if entry.get("type") is not None else "transport"
        if entry.get(key) is None:
            if not has_url:
                return STDIO
            return SSE if urllib.parse.urlsplit(str(entry["url"])).path.rstrip("/").endswith("/sse") else HTTP
        transport = _TRANSPORTS.get(entry[key]) if isinstance(entry[key], str) else None
        if transport is None:
            self.wrong(key, f"must be 'stdio', 'http' (streamable HTTP) or 'sse', not {entry[key]!r}")
        if (transport == STDIO) == has_url:
            self.wrong(key, f"is {entry[key]!r}, which does not go with a {'url' if has_url else 'command'!r}")
        return transport

    def _url(self, entry: Mapping[str, Any]) -> str:
        url = self._text(entry, "url")
        try:
            parts = urllib.parse.urlsplit(url)
            right = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        except ValueError:
            right = False
        if not right or any(character.isspace() for character in url):
            # Not shown: an address may hold a password.
            self.wrong("url", "must look like 'http://localhost:8000/mcp'")
        return url

    def _text(self, entry: Mapping[str, Any], key: str) -> str:
        if not isinstance(entry[key], str):
            self.wrong(key, f"must be text, not {_kind(entry[key])}")
        return self._expanded(key, entry[key])

    def _list(self, entry: Mapping[str, Any], key: str) -> tuple[str, ...]:
        values = entry.get(key, [])
        if not isinstance(values, list | tuple) or not all(isinstance(value, str) for value in values):
            self.wrong(key, f"must be a list of texts, not {_kind(values)}")
        return tuple(self._expanded(key, value) for value in values)

    def _pairs(self, entry: Mapping[str, Any], key: str) -> tuple[tuple[str, str], ...]:
        values = entry.get(key)
        if values is None:
            return ()
        if not isinstance(values, Mapping):
            self.wrong(key, f"must be an object of texts, not {_kind(values)}")
        pairs = []
        for name, value in values.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                value = str(value)  # as clients do that hand it to a shell
            if not isinstance(name, str) or not name or "=" in name or not isinstance(value, str):
                self.wrong(key, f"must be an object of texts; {name!r} is {_kind(value)}")
            if "\n" in name + value and key == "headers":
                self.wrong(key, f"{name!r} holds a line break")
            pairs.append((name, self._expanded(key, value)))
        return tuple(pairs)

    def flag(self, entry: Mapping[str, Any], key: str, default: bool) -> bool:
        value = entry.get(key, default)
        if not isinstance(value, bool):
            self.wrong(key, f"must be true or false, not {_kind(value)}")
        return value

    def _expanded(self, key: str, text: str) -> str:
        self._key = key
        expanded = self.expand(text)
        if "\0" in expanded:
            self.wrong(key, "holds a null character")
        return expanded

    def expanded(self, text: str) -> str:
        return _VARIABLE.sub(lambda match: self._variable(match.group(1)), text)

    def _variable(self, variable: str) -> str:
        if variable == "userHome":
            return str(Path.home())
        if variable in ("workspaceFolder", "configDir") and self.folder is not None:
            return str(self.folder)
        if variable == "pathSeparator":
            return os.sep
        if variable.startswith("input:"):
            self.wrong(
                self._key,
                f"asks the user for ${{{variable}}}, and nobody is there to be asked; "
                f"use a variable of the environment, as in ${{NAME}}",
            )
        name, has_default, default = variable.removeprefix("env:").partition(":-")
        if not _NAME.fullmatch(name):
            return f"${{{variable}}}"  # for the shell, or the server, to make something of
        value = os.environ.get(name)
        if value is None or (has_default and not value):
            if not has_default:
                self.wrong(self._key, f"needs the environment variable {name}, which is not set")
            return default
        return value


def _kind(value: object) -> str:
    for kinds, word in (((bool,), "true or false"), ((str,), "text"), ((int, float), "a number"), ((list,), "a list")):
        if isinstance(value, kinds):
            return word
    return "null" if value is None else "an object" if isinstance(value, Mapping) else type(value).__name__
