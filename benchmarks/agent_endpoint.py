"""After a change of gem-server: what the agent endpoint adds to a request, at 64 at once, beside LiteLLM's proxy.

A model server in a process of its own answers at once. The client asks it alone, then by the endpoint with the agent
``openai:MODEL`` behind it, then through LiteLLM's proxy, where ``--litellm`` names its command. Milliseconds a request
are the wall time of all requests divided by their number.
"""

from __future__ import annotations

import argparse
import sys

import harness
from openai_overhead import SERVER

REQUESTS, AT_ONCE = 1280, 64

CLIENT = f"""
import asyncio, json, subprocess, sys, time, urllib.request
import aiohttp

HOW, COMMAND = sys.argv[1], sys.argv[2]
BODY = {{"model": "m", "messages": [{{"role": "user", "content": "Tell me something. " * 20}}]}}
server = subprocess.Popen([sys.executable, "-c", {SERVER.replace("asyncio.sleep(0.1)", "asyncio.sleep(0)")!r}],
                          stdout=subprocess.PIPE, text=True)
port = int(server.stdout.readline())

async def load(urls, keys):
    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        async def one(slot, count):
            for _ in range(count):
                head = {{"authorization": "Bearer " + keys[slot % len(keys)]}}
                async with session.post(urls, json=BODY, headers=head) as reply:
                    assert (await reply.json())["choices"][0]["message"]["content"]
        await asyncio.gather(*(one(slot, 2) for slot in range({AT_ONCE})))
        began = time.perf_counter()
        await asyncio.gather(*(one(slot, {REQUESTS // AT_ONCE}) for slot in range({AT_ONCE})))
        return time.perf_counter() - began

def bare():
    return asyncio.run(load(f"http://127.0.0.1:{{port}}/v1/chat/completions", ["none"]))

def ours():
    from gem_core.background import run_sync
    from gem_core.rollouts import Context
    from gem_openai import OpenAIAgent
    from gem_server import Endpoint
    endpoint, agent = Endpoint(), OpenAIAgent("m", base_url=f"http://127.0.0.1:{{port}}/v1")
    async def serve(session):
        while True:
            pending = await session.requests.get()
            context = Context("0.0", "bench", None, 0, {{}}, pending.asked.tools, [])
            pending.reply.set_result(await agent(pending.asked.messages, context))
    async def begin():
        sessions = [await endpoint.open() for _ in range({AT_ONCE})]
        global tasks
        tasks = [asyncio.create_task(serve(session)) for session in sessions]
        return [session.key for session in sessions]
    keys = run_sync(begin())
    return asyncio.run(load(endpoint.address + "/v1/chat/completions", keys))

def litellm():
    import socket
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        own = free.getsockname()[1]
    import os
    variables = {{**os.environ, "OPENAI_API_KEY": "none", "LITELLM_LOG": "ERROR",
                 "LITELLM_DANGEROUSLY_PERMIT_WEAK_OR_UNSET_MASTER_KEY": "true"}}
    base = f"http://127.0.0.1:{{port}}/v1"
    command = [COMMAND, "--model", "openai/m", "--api_base", base, "--port", str(own), "--host", "127.0.0.1"]
    proxy = subprocess.Popen(command, env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(1200):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{{own}}/health/liveliness")
                break
            except OSError:
                time.sleep(0.1)
        return asyncio.run(load(f"http://127.0.0.1:{{own}}/chat/completions", ["none"]))
    finally:
        proxy.kill()

try:
    wall = {{"bare": bare, "ours": ours, "litellm": litellm}}[HOW]()
finally:
    server.kill()
print(json.dumps({{"ms": wall / {REQUESTS} * 1000}}))
"""


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--litellm", default="", help="command of LiteLLM's proxy, to measure beside it")
    own, rest = parser.parse_known_args()
    sys.argv[1:] = rest
    sides = harness.arguments()
    names = ["bare", "ours", *(["litellm"] if own.litellm else [])]
    cases = harness.measure(
        {name: [*harness.snippet(sides.ours, CLIENT), name, own.litellm] for name in names},
        repeats=min(sides.repeats, 5),
        warm_up=1,
    )
    bare = cases["bare"].median("ms")
    rows = [
        [label, f"{cases[name].median('ms'):.2f}", f"{cases[name].median('ms') - bare:.2f}"]
        for name, label in (("bare", "the model server alone"), ("ours", "gem-server"), ("litellm", "LiteLLM's proxy"))
        if name in cases
    ]
    harness.print_table(f"{REQUESTS} requests, {AT_ONCE} at once", ["through", "ms a request", "added, ms"], rows)


if __name__ == "__main__":
    main()
