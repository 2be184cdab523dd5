"""An MCP server that misbehaves as it is told, on standard input and output, in nothing but the standard library.

``python mcp_bad_server.py WAY…``; without a way it behaves. Its tools: ``echo`` gives its text back, ``count`` counts
the calls of this process, ``slow`` waits until it is cancelled, ``die`` ends the process, ``blob`` gives as many
characters as it is asked for, ``error`` answers with a code, ``note`` writes to the file ``NOTES`` and counts what is
there, ``pid`` gives ids of processes, ``shapes`` gives each kind of content, ``ask`` asks the client for a completion,
``cancelled`` counts the calls given up.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

WAYS = set(sys.argv[1:])
TOOLS = ("echo", "count", "slow", "die", "blob", "pid", "shapes", "ask", "error", "note", "cancelled")
state = {"count": 0, "cancelled": 0}
waiting: dict[str, object] = {}
PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg=="


def say(line: str) -> None:
    """Write one line."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def send(message: dict[str, object]) -> None:
    """Write one message."""
    say(json.dumps({"jsonrpc": "2.0", **message}))


def answer(request: object, result: dict[str, object]) -> None:
    """Answer a request, under the wrong id if so told."""
    if "modern" in WAYS:
        result = {"resultType": "complete", "ttlMs": 0, "cacheScope": "public", **result}
    if "wrong-ids" in WAYS and "protocolVersion" not in result and "tools" not in result:
        send({"id": 987654, "result": result})
        send({"id": "nonsense", "result": result})
        return
    send({"id": request, "result": result})


def text(request: object, words: str, **more: object) -> None:
    """Answer with text."""
    answer(request, {"content": [{"type": "text", "text": words}], **more})


def tool(name: str) -> dict[str, object]:
    """Describe a tool."""
    properties: dict[str, object] = {
        "echo": {"text": {"type": "string"}},
        "blob": {"size": {"type": "integer", "minimum": 1}},
        "error": {"code": {"type": "integer"}},
    }.get(name, {})
    schema = {"type": "object", "properties": properties, "required": list(properties), "additionalProperties": False}
    return {"name": name, "description": f"Does {name}.", "inputSchema": schema}


def listed(request: object, params: dict[str, object]) -> None:
    """Answer tools/list."""
    tools = [tool(name) for name in TOOLS]
    if "wrong-schema" in WAYS:
        tools[0]["inputSchema"] = {
            "type": "object",
            "properties": {"text": {"type": 12, "$ref": "http://127.0.0.1:1/x"}},
        }
        tools[1]["inputSchema"] = "nonsense"
        tools += [{"description": "has no name"}, 7]  # type: ignore[list-item]
    if "duplicates" in WAYS:
        tools += [tool("echo"), tool("odd näme! with/slashes"), tool("odd näme? with/slashes"), tool("x" * 200)]
    if "endless-pages" in WAYS:
        page = int(str(params.get("cursor", "0")))
        answer(request, {"tools": [tool(f"t{page}_{i}") for i in range(30)], "nextCursor": str(page + 1)})
    elif "pages" in WAYS:
        page = int(str(params.get("cursor", "0")))
        result: dict[str, object] = {"tools": tools[page : page + 4]}
        if page + 4 < len(tools):
            result["nextCursor"] = str(page + 4)
        answer(request, result)
    else:
        answer(request, {"tools": tools})


def call(request: object, name: str, arguments: dict[str, object]) -> None:
    """Answer tools/call."""
    state["count"] += 1
    if "log" in WAYS:
        with Path(os.environ["CALLS"]).open("a") as file:
            file.write(f"{name}\n")
    if name in ("count", "cancelled"):
        text(request, str(state[name]))
        while "deaf" in WAYS:
            time.sleep(1000)
    elif name == "slow":
        waiting[str(request)] = request
    elif name == "error":
        send({"id": request, "error": {"code": arguments["code"], "message": "as asked"}})
    elif name == "shapes":
        shapes(request)
    elif name == "ask":
        waiting["asked"] = request
        send({"id": "asked", "method": "sampling/createMessage", "params": {"messages": [], "maxTokens": 1}})
    else:
        effect(request, name, arguments)


def effect(request: object, name: str, arguments: dict[str, object]) -> None:
    """Answer a call that does something."""
    if name == "echo":
        text(request, str(arguments.get("text")))
    elif name == "note":
        notes = Path(os.environ["NOTES"])
        with notes.open("a") as file:
            file.write("x")
        text(request, f"{len(notes.read_text())} {Path.cwd() == notes.parent}")
    elif name == "blob":
        text(request, "x" * int(str(arguments["size"])))
    elif name == "die":
        sys.stderr.write("I was told to die\n")
        sys.stderr.flush()
        os._exit(3)
    elif name == "pid":
        child = subprocess.Popen(["sleep", "1000"], start_new_session=True)
        text(request, f"{os.getpid()} {child.pid}")
    else:
        text(request, f"no tool {name}", isError=True)


def shapes(request: object) -> None:
    """Answer with each kind of content."""
    content: list[object] = [
        {"type": "text", "text": "words"},
        {"type": "image", "data": PIXEL, "mimeType": "image/png"},
        {"type": "image", "data": "bm8gaW1hZ2U=", "mimeType": "image/png"},
        {"type": "audio", "data": "AAAA", "mimeType": "audio/wav"},
        {"type": "resource_link", "uri": "notes:///a", "name": "A", "mimeType": "text/plain"},
        {"type": "resource", "resource": {"uri": "notes:///b", "text": "inside"}},
        {"type": "resource", "resource": {"uri": "notes:///c", "blob": "AAAA", "mimeType": "application/zip"}},
        {"type": "something new"},
        "nonsense",
    ]
    answer(request, {"content": content, "structuredContent": {"n": 1}})


def handle(message: dict[str, object]) -> None:
    """Do what a message asks."""
    method, request = message.get("method"), message.get("id")
    params = message.get("params")
    params = params if isinstance(params, dict) else {}
    if method == "initialize" and "modern" not in WAYS:
        start(request, params)
    elif method == "server/discover" and "modern" in WAYS:
        answer(request, {"supportedVersions": ["2026-07-28"], "capabilities": {"tools": {}}})
    elif method == "tools/list" and "no-list" in WAYS:
        sys.stderr.write("I keep this to myself\n")
        sys.stderr.flush()
    elif method == "tools/list":
        listed(request, params)
    elif method == "tools/call":
        call(request, str(params.get("name")), params.get("arguments") or {})
    elif method == "notifications/cancelled":
        state["cancelled"] += 1
        waiting.pop(str(params.get("requestId")), None)
    elif method is None and request == "asked":
        text(waiting.pop("asked"), json.dumps(message.get("error") or message.get("result")))
    elif method and request is not None:
        send({"id": request, "error": {"code": -32601, "message": f"no method {method}"}})


def start(request: object, params: dict[str, object]) -> None:
    """Answer initialize, or not."""
    if "mute" in WAYS:
        return
    if "refuse" in WAYS:
        send({"id": request, "error": {"code": -32603, "message": "not today"}})
        return
    capabilities = {"tools": {}}
    info = {"name": "bad", "version": "1"}
    version = params.get("protocolVersion")
    answer(request, {"protocolVersion": version, "capabilities": capabilities, "serverInfo": info})


def main() -> None:
    """Serve until standard input ends, and longer if so told."""
    if "die-at-start" in WAYS:
        sys.stderr.write("cannot open the database\n")
        sys.exit(2)
    if "garbage" in WAYS:
        say("Server started!")
        say('{"jsonrpc": "2.0", "id": ')
        say(b"\xff\xfe".decode("latin-1"))
        say("[" * 100_000)
    if "flood" in WAYS:
        while True:
            sys.stdout.write("x" * 65536)
    for line in sys.stdin:
        if "garbage" in WAYS:
            say("got a line")
        handle(json.loads(line))
    while "stay" in WAYS:
        time.sleep(1000)


main()
