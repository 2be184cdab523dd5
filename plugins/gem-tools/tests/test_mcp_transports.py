"""A server of the protocol's own package, over each transport."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from mcp_helping import PATIENCE_S, around, step, wait_until_no_server_runs

SERVER = '''
import sys
from mcp.server.mcpserver import MCPServer

server = MCPServer("library")

@server.tool()
def lend(title: str) -> dict[str, str]:
    """Lends a book"""
    return {"title": title, "until": "Friday"}

if sys.argv[1] == "stdio":
    server.run()
else:
    server.run(transport=sys.argv[1], port=int(sys.argv[2]))
'''


@pytest.fixture(scope="module", params=["stdio", "streamable-http", "sse"])
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Options for the server, over one of the transports."""
    path = tmp_path_factory.mktemp("library") / "library.py"
    path.write_text(SERVER, encoding="utf-8")
    if request.param == "stdio":
        yield {"command": sys.executable, "args": [str(path), "stdio"], "server_name": "library"}
        wait_until_no_server_runs()
        return
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, str(path), request.param, str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + PATIENCE_S
        while True:  # until it listens
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                if process.poll() is not None or time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
        yield {"url": f"http://127.0.0.1:{port}/{'sse' if request.param == 'sse' else 'mcp'}", "server_name": "library"}
    finally:
        process.kill()
        process.wait()


@pytest.mark.few(1)
def test_its_tools_are_called(library):
    env = around(("mcp", library))
    assert list(env.tools) == ["lend"]
    observation, info = step(env, "lend", title="Emma")
    assert info["structured"] == {"title": "Emma", "until": "Friday"}
    assert '"until": "Friday"' in observation
    assert step(env, "lend", title=[1])[1]["failed"]
    env.close()
