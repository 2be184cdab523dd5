"""What the tool ``mcp`` adds to a call: its calls per second beside those of the protocol library's bare client.

Both sides call the same tool, which gives its text back, of the same server over standard input and output: one call
after another, and 32 under way at once over one session. Ours go through an environment (``step`` in plain code, and
``step_async``), which reads the call in the response, checks its arguments against the schema and renders the result.
The peer, gem-llm, is not measured: its tool needs other versions of the same packages.
"""

from __future__ import annotations

import argparse
import sys

import harness

AT_ONCE = 32

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

BARE = """
import asyncio, json, sys, time
from mcp import ClientSession, StdioServerParameters, stdio_client

async def main(calls, at_once, server):
    parameters = StdioServerParameters(command=sys.executable, args=["-c", server])
    async with stdio_client(parameters) as streams, ClientSession(*streams) as session:
        await session.initialize()
        await session.list_tools()

        async def call(times):
            for _ in range(times):
                result = await session.call_tool("echo", {"text": "hello"})
                if result.content[0].text != "hello":
                    sys.exit("wrong answer")

        await call(50)
        started = time.perf_counter()
        await call(calls)
        one = time.perf_counter() - started
        started = time.perf_counter()
        await asyncio.gather(*(call(calls // at_once) for _ in range(at_once)))
        many = time.perf_counter() - started
    print(json.dumps({"one_s": one / calls, "many_s": many / (calls // at_once * at_once)}))

asyncio.run(main(int(CALLS), int(AT_ONCE), SERVER))
"""

OURS = """
import asyncio, json, sys, time
from gem_core.background import run_sync
from gem_core.data import DatasetEnv
from gem_core.tools import ToolEnv

def make():
    task = DatasetEnv([{"question": "?", "answer": "1"}])
    options = {"command": sys.executable, "args": ["-c", SERVER], "sessions": "shared"}
    env = ToolEnv(task, [("mcp", options)], max_tool_uses=None)
    env.reset(seed=0)
    return env

ACTION = '<tool_call>{"name": "echo", "arguments": {"text": "hello"}}</tool_call>'

def right(result):
    if "hello" not in result[0]:
        sys.exit(f"wrong answer: {result[0]}")

def main(calls, at_once):
    env = make()
    for _ in range(50):
        right(env.step(ACTION))
    started = time.perf_counter()
    for _ in range(calls):
        right(env.step(ACTION))
    one = time.perf_counter() - started
    envs = [make() for _ in range(at_once)]

    async def call(env, times):
        for _ in range(times):
            right(await env.step_async(ACTION))

    async def all_calls():
        await asyncio.gather(*(call(env, calls // at_once) for env in envs))

    started = time.perf_counter()
    run_sync(all_calls())
    many = time.perf_counter() - started
    for each in [env, *envs]:
        each.close()
    print(json.dumps({"one_s": one / calls, "many_s": many / (calls // at_once * at_once)}))

main(int(CALLS), int(AT_ONCE))
"""


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_tools")
    parser.add_argument("--peer", help="not used here; 'make bench' names it to every benchmark")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each case, after one to warm up")
    parser.add_argument("--calls", type=int, default=1600, help="in a run")
    options = parser.parse_args()
    given = f"CALLS, AT_ONCE, SERVER = {options.calls}, {AT_ONCE}, {SERVER!r}\n"
    results = harness.measure(
        {name: harness.snippet(options.ours, given + code) for name, code in (("bare", BARE), ("ours", OURS))},
        repeats=options.repeats,
        warm_up=1,
    )
    rows = []
    for title, figure in (("one after another", "one_s"), (f"{AT_ONCE} at once", "many_s")):
        bare, ours = results["bare"].median(figure), results["ours"].median(figure)
        rows.append((title, f"{1 / bare:,.0f}", f"{1 / ours:,.0f}", f"{bare / ours:.2f}", f"{(ours - bare) * 1e3:.2f}"))
    header = ("calls of an MCP server over stdio", "bare/s", "ours/s", "ratio", "added ms")
    harness.print_table("The tool mcp beside the bare client", header, rows)


if __name__ == "__main__":
    main()
