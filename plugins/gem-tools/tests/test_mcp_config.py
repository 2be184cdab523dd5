"""Configuration files and keywords of the tool ``mcp``, and what their errors say."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcp_helping import BAD_SERVER

from gem_core.errors import ArgumentError, GemError
from gem_tools.mcp.config import Server, from_keywords, read_config
from gem_tools.mcp.tool import make_mcp


def one(entry: Any, **more: Any) -> Server:
    """Read a configuration of one server."""
    (server,) = read_config({"mcpServers": {"a": entry}, **more})
    return server


def test_a_file_of_claude_desktop_is_read(tmp_path: Path):
    path = tmp_path / "claude_desktop_config.json"
    path.write_text(
        json.dumps(
            {
                "globalShortcut": "",
                "mcpServers": {
                    "files": {"command": "npx", "args": ["-y", "server", "/tmp"], "env": {"KEY": "value", "N": 3}},
                    "off": {"command": "x", "disabled": True},
                },
            }
        )
    )
    assert read_config(path) == [
        Server("files", command="npx", args=("-y", "server", "/tmp"), env=(("KEY", "value"), ("N", "3")))
    ]


def test_files_of_cursor_and_vs_code_are_read(monkeypatch, tmp_path):
    monkeypatch.setenv("TOKEN", "s3cret")
    cursor = {"mcpServers": {"web": {"url": "https://example.com/mcp", "headers": {"X-Key": "${env:TOKEN}"}}}}
    assert read_config(cursor) == [
        Server("web", url="https://example.com/mcp", headers=(("X-Key", "s3cret"),), transport="http")
    ]
    path = tmp_path / "mcp.json"
    entry = {"type": "stdio", "command": "${workspaceFolder}/run", "cwd": "${workspaceFolder}", "dev": {"watch": "*"}}
    path.write_text("\ufeff" + json.dumps({"inputs": [], "servers": {"local": entry}}), encoding="utf-8")
    assert read_config(str(path)) == [Server("local", command=f"{tmp_path}/run", cwd=str(tmp_path))]


@pytest.mark.parametrize(
    ("entry", "transport"),
    [
        ({"url": "http://h/mcp"}, "http"),
        ({"url": "http://h/sse"}, "sse"),
        ({"url": "http://h/sse/?a=1"}, "sse"),
        ({"url": "http://h/sse", "type": "streamable-http"}, "http"),
        ({"url": "http://h/mcp", "type": "streamableHttp"}, "http"),
        ({"url": "http://h/mcp", "transport": "sse"}, "sse"),
        ({"command": "x"}, "stdio"),
    ],
)
def test_the_transport_is_found(entry, transport):
    assert one(entry).transport == transport


def test_variables_are_those_of_the_environment(monkeypatch):
    monkeypatch.setenv("A", "1")
    monkeypatch.setenv("EMPTY", "")
    monkeypatch.delenv("UNSET", raising=False)
    args = ["${A}", "x${env:A}y${A}", "${UNSET:-b:-c}", "${EMPTY:-d}", "${EMPTY}", "$A", "${not a name}", "${userHome}"]
    assert one({"command": "x", "args": args}).args == (
        "1", "x1y1", "b:-c", "d", "", "$A", "${not a name}", str(Path.home()),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("entry", "key"),
    [
        (7, "must be an object"),
        ({}, "neither a 'command' nor a 'url'"),
        ({"command": "x", "url": "http://h"}, "both a 'command' and a 'url'"),
        ({"command": []}, "key 'command'"),
        ({"command": " "}, "key 'command'"),
        ({"command": "x", "args": "y"}, "key 'args'"),
        ({"command": "x", "arg": []}, "did you mean 'args'?"),
        ({"command": "x", "env": {"A": None}}, "key 'env.A'"),
        ({"command": "x", "type": "websocket"}, "key 'type'"),
        ({"command": "x", "type": "sse"}, "key 'type'"),
        ({"url": "http://h", "type": "stdio"}, "key 'type'"),
        ({"url": "ftp://user:secret@h"}, "key 'url'"),
        ({"command": "x", "disabled": "no"}, "key 'disabled'"),
        ({"command": "x", "args": ["${GEM_UNSET}"]}, "key 'args.0': needs the environment variable GEM_UNSET"),
        ({"command": "x", "env": {"K": "${input:key}"}}, "key 'env.K'"),
    ],
)
def test_errors_name_the_server_and_the_key(entry, key):
    with pytest.raises(ArgumentError, match=re.escape(key)) as caught:
        one(entry)
    assert str(caught.value).startswith("the configuration: server 'a'")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        b'{"mcpServers": {"a": {}}}',
        b'{"mcpServers": {}}',
        b'{"mcpServers": {"a": {"disabled": true}}}',
        b"[1]",
        b"{\n // a comment\n}",
        b"\xff",
        b"[" * 100_000,
        None,
    ],
)
def test_errors_name_the_file(tmp_path, content):
    path = tmp_path / "servers.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ArgumentError, match=re.escape(str(path))):
        read_config(path)


def test_a_folder_is_relative_to_the_file(tmp_path):
    path = tmp_path / "servers.json"
    path.write_text('{"mcpServers": {"a": {"command": "x", "cwd": "sub"}}}')
    assert read_config(path)[0].cwd == str(tmp_path / "sub")


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.text(max_size=5)
        | st.sampled_from(["mcpServers", "${A:-", "${"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["mcpServers", "command", "args", "env", "url", "type", "a"]), inner)
        ),
        max_leaves=10,
    )
)
def test_any_content_is_read_or_refused(content):
    """No configuration, however odd, fails in another way than by our error."""
    for whole in (content, {"mcpServers": content}, {"mcpServers": {"a": content}}):
        if isinstance(whole, dict):
            try:
                servers = read_config(whole)
            except ArgumentError:
                continue
            assert all(server.command or server.url for server in servers)


@pytest.mark.parametrize(
    "options",
    [{}, {"config": {}, "command": "x"}, {"command": "x", "sessions": "own"}, {"command": "x", "args": "y"}],
)
def test_wrong_options_are_refused(options):
    with pytest.raises(ArgumentError):
        make_mcp(**options)


# What is said of servers: by their names, and without the secrets that they were given.


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"command": "/opt/bin/mcp-server-time", "args": ["-v"]}, "mcp-server-time"),
        ({"command": "npx -y some-server"}, "npx"),
        ({"url": "http://127.0.0.1:8000/mcp"}, "127.0.0.1:8000"),
        ({"url": "https://me:secret@example.com/key/mcp"}, "example.com"),
    ],
)
def test_a_server_is_named_for_its_program_or_host(options, name):
    assert from_keywords(options).name == name
    assert from_keywords(options, "mine").name == "mine"


def test_a_command_line_in_the_place_of_a_program_is_taken_apart():
    """As some clients allow, and as one types it."""
    servers = read_config({"mcpServers": {"a": {"command": "npx -y 'a server'", "args": ["/tmp"]}}})
    assert (servers[0].command, servers[0].args) == ("npx", ("-y", "a server", "/tmp"))
    tools = make_mcp(command=f"{sys.executable} -S {BAD_SERVER}", include=["echo"])
    assert tools[0].server.name == Path(sys.executable).name


def test_a_program_with_a_space_in_its_path_stays_whole(tmp_path):
    program = tmp_path / "my server"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert from_keywords({"command": str(program)}).command == str(program)


def test_secrets_of_a_server_are_blotted_out_of_what_it_says():
    key = "0123456789abcdef01234567"
    server = Server(
        "a",
        url=f"https://me:pass%20word@h/{key}/mcp?api=querysecret",
        headers=(("Authorization", "Bearer headersecret"),),
        transport="http",
    )
    assert server.place == "https://h/…/mcp"
    said = f"no 'pass word', {key}, querysecret, headersecret, Bearer headersecret for h"
    assert server.without_secrets(said) == "no '***', ***, ***, ***, *** for h"
    assert Server("a", command="x", env=(("N", "5"), ("T", "longer"))).without_secrets("5 longer") == "5 ***"


def test_all_servers_that_cannot_be_used_are_named():
    servers = {
        "good": {"command": sys.executable, "args": ["-S", BAD_SERVER]},
        "gone": {"command": "no-such-program"},
        "broken": {"command": sys.executable, "args": ["-S", BAD_SERVER, "die-at-start"]},
    }
    with pytest.raises(GemError, match=r"^2 of 3 MCP servers cannot be used: .*'gone'.*; .*'broken'.*cannot open"):
        make_mcp({"mcpServers": servers})
    servers["gone"]["disabled"] = servers["broken"]["disabled"] = True
    assert make_mcp(json.loads(json.dumps({"mcpServers": servers})))
