"""After a change of the tool ``mcp``: the time of a call beside that of the protocol library's bare client.

Both sides call the same tool, which gives its text back, of the same server over standard input and output: one call
after another, and in eight sessions at once, each with a server of its own. Figures are medians of single calls: of the
tool itself (``validate`` and ``call``, on the library's event loop), of ``step_async`` of an environment, which reads
the call in the response and renders the result, and of ``step`` in plain code, which also changes threads.
The peer, gem-llm, is not measured: its tool needs other versions of the same packages.
"""

from __future__ import annotations

import argparse
import sys

import harness

AT_ONCE = 8

SERVER = """
import json, sys
for line in sys.stdin:
    message = json.loads(line)
    method, result = message.get("method"), None
    if method == "initialize":
        result = {"protocolVersion": message["params"]["protocolVersion"], "capabilities": {"tools": {}}}
        result["serverInfo"] = {"name": "echo", "version": "1"}
    elif method == "tools/list":
        schema = {"type": "object", "properties": {"text": {"type": "string"}}, "required": ["text"]}
        result = {"tools": [{"name": "echo", "description": "Echoes.", "inputSchema": schema}]}
    elif method == "tools/call":
        result = {"content": [{"type": "text", "text": message["params"]["arguments"]["text"]}]}
    if "id" in message:
        print(json.dumps({"jsonrpc": "2.0", "id": message["id"], "result": result}), flush=True)
"""

COMMON = """
import asyncio, json, statistics, sys, time

async def median(call):
    times = []
    for _ in range(CALLS + 50):
        started = time.perf_counter()
        if "hello" not in await call():
            sys.exit("wrong answer")
        times.append(time.perf_counter() - started)
    return statistics.median(times[50:])
"""

BARE = """
from mcp import ClientSession, StdioServerParameters, stdio_client

async def one():
    parameters = StdioServerParameters(command=sys.executable, args=["-c", SERVER])
    async with stdio_client(parameters) as streams, ClientSession(*streams) as session:
        await session.initialize()
        await session.list_tools()

        async def call():
            return (await session.call_tool("echo", {"text": "hello"})).content[0].text

        return await median(call)

async def many():
    return statistics.median(await asyncio.gather(*(one() for _ in range(AT_ONCE))))

print(json.dumps({"one_s": asyncio.run(one()), "many_s": asyncio.run(many())}))
"""

OURS = """
from gem_core.background import run_sync
from gem_core.data import DatasetEnv
from gem_core.tools import ToolEnv

ACTION = '<tool_call>{"name": "echo", "arguments": {"text": "hello"}}</tool_call>'

def make():
    task = DatasetEnv([{"question": "?", "answer": "1"}])
    env = ToolEnv(task, [("mcp", {"command": sys.executable, "args": ["-c", SERVER]})], max_tool_uses=None)
    env.reset(seed=0)
    return env

async def tool(env):
    echo = env.tools["echo"]
    session = await echo.open()

    async def call():
        return (await echo.call(echo.validate({"text": "hello"}), session)).content

    try:
        return await median(call)
    finally:
        await echo.close(session)

async def step(env):
    async def call():
        return (await env.step_async(ACTION))[0]

    return await median(call)

async def many(envs, of):
    return statistics.median(await asyncio.gather(*map(of, envs)))

async def plain(env):
    async def call():
        return env.step(ACTION)[0]

    return await median(call)

envs = [make() for _ in range(AT_ONCE)]
print(json.dumps({
    "tool_one_s": run_sync(tool(envs[0])),
    "tool_many_s": run_sync(many(envs, tool)),
    "step_one_s": run_sync(step(envs[0])),
    "step_many_s": run_sync(many(envs, step)),
    "plain_one_s": asyncio.run(plain(envs[0])),
}))
for env in envs:
    env.close()
"""


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_tools")
    parser.add_argument("--peer", help="not used here; 'make bench' names it to every benchmark")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each case, after one to warm up")
    parser.add_argument("--calls", type=int, default=500, help="in a run, one after another")
    options = parser.parse_args()
    given = f"CALLS, AT_ONCE, SERVER = {options.calls}, {AT_ONCE}, {SERVER!r}\n{COMMON}"
    results = harness.measure(
        {name: harness.snippet(options.ours, given + code) for name, code in (("bare", BARE), ("ours", OURS))},
        repeats=options.repeats,
        warm_up=1,
    )
    rows = []
    for title, figure, base in (
        ("the tool", "tool_one_s", "one_s"),
        (f"the tool, {AT_ONCE} sessions at once", "tool_many_s", "many_s"),
        ("step_async", "step_one_s", "one_s"),
        (f"step_async, {AT_ONCE} sessions at once", "step_many_s", "many_s"),
        ("step in plain code", "plain_one_s", "one_s"),
    ):
        bare, ours = results["bare"].median(base), results["ours"].median(figure)
        rows.append((title, f"{bare * 1e3:.2f}", f"{ours * 1e3:.2f}", f"{ours / bare:.2f}"))
    header = ("a call of an MCP server over stdio", "bare ms", "ours ms", "times")
    harness.print_table("The tool mcp beside the bare client", header, rows)


if __name__ == "__main__":
    main()
