"""After a change of gem-openai: what a turn costs, and how busy 64 episodes keep a server that answers in 0.1 s.

The server runs in a process of its own and counts, over time, how many requests it has in flight. Our own time is the
processor time of the process that rolls out, all of it (environment, rollout, agent, HTTP), divided by the turns. The
peer, gem-llm, has no client to compare with.
"""

from __future__ import annotations

import subprocess

import harness

EPISODES, TURNS, ANSWER_S = 64, 20, 0.1
BUDGET_S = 0.001
MOST_REPEATS = 5  # a run takes two seconds of waiting

SERVER = f"""
import asyncio, json, time
TEXT = "I think, therefore I answer. " * 20
BODY = json.dumps({{"model": "m", "choices": [{{"index": 0, "finish_reason": "stop",
    "message": {{"role": "assistant", "content": TEXT}}}}],
    "usage": {{"prompt_tokens": 9, "completion_tokens": 99, "total_tokens": 108}}}}).encode()
in_flight, area, first, last = 0, 0.0, None, 0.0

def changed(by):
    global in_flight, area, first, last
    now = time.perf_counter()
    if first is None:
        first = last = now
    area += in_flight * (now - last)
    in_flight, last = in_flight + by, now

async def serve(reader, writer):
    global area, first
    try:
        while True:
            head = await reader.readuntil(b"\\r\\n\\r\\n")
            body = BODY
            if head.startswith(b"POST"):
                fields = (line.lower().partition(b":") for line in head.split(b"\\r\\n"))
                (length,) = [int(value) for name, _, value in fields if name == b"content-length"]
                await reader.readexactly(length)
                changed(+1)
                await asyncio.sleep({ANSWER_S})
                changed(-1)
            elif b"/figures" in head:
                body = json.dumps({{"in_flight": area / (last - first)}}).encode()
                area, first = 0.0, None
            else:
                body = b'{{"data": [{{"id": "m"}}]}}'
            writer.write(b"HTTP/1.1 200 OK\\r\\nContent-Type: application/json\\r\\n")
            writer.write(b"Content-Length: %d\\r\\n\\r\\n" % len(body) + body)
            await writer.drain()
    except asyncio.IncompleteReadError:
        writer.close()

async def main():
    server = await asyncio.start_server(serve, "127.0.0.1", 0, backlog=512)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()

asyncio.run(main())
"""

CLIENT = f"""
import json, subprocess, sys, time, urllib.request
import gem_core as gem
from gem_openai import OpenAIAgent

class TalkEnv(gem.Env):
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.turn = 0
        return "Tell me something. " * 20, {{}}
    def step(self, action):
        self.turn += 1
        return "Go on. " * 20, 0.0, self.turn >= {TURNS}, False, {{}}

gem.register("bench:Talk-v0", TalkEnv)
server = subprocess.Popen([sys.executable, "-c", {SERVER!r}], stdout=subprocess.PIPE, text=True)
try:
    url = f"http://127.0.0.1:{{int(server.stdout.readline())}}/v1"
    agent = OpenAIAgent("m", base_url=url, max_concurrency={EPISODES})
    list(gem.rollout(gem.make_vec("bench:Talk-v0", 1), agent, episodes=1))  # imports what is needed
    urllib.request.urlopen(url + "/figures").read()  # counts from here
    started, used = time.perf_counter(), time.process_time()
    episodes = list(gem.rollout(gem.make_vec("bench:Talk-v0", {EPISODES}), agent, episodes={EPISODES}, seed=1))
    wall, used = time.perf_counter() - started, time.process_time() - used
    turns = sum(episode.turns for episode in episodes)
    figures = json.load(urllib.request.urlopen(url + "/figures"))
finally:
    server.kill()
print(json.dumps({{"own_s": used / turns, "rollout_s": wall, **figures}}))
"""


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    if subprocess.run([sides.ours, "-c", "import gem_openai"], capture_output=True, check=False).returncode:
        print("\nthe agent 'openai' skipped: gem-openai is not installed")
        return
    repeats = min(sides.repeats, MOST_REPEATS)
    case = harness.measure({"ours": harness.snippet(sides.ours, CLIENT)}, repeats=repeats, warm_up=1)["ours"]
    own, wall = case.median("own_s"), case.median("rollout_s")
    ideal = TURNS * ANSWER_S
    rows = [
        ["own time per turn, ms", f"{own * 1e3:.2f}", f"{BUDGET_S * 1e3:.0f}", harness.verdict(own, BUDGET_S)],
        [f"requests in flight, mean of {EPISODES}", f"{case.median('in_flight'):.1f}", "", ""],
        ["wall time, s", f"{wall:.2f}", f"{ideal:.2f} if all overlap", ""],
    ]
    title = f"{EPISODES} episodes of {TURNS} turns, a server that answers in {ANSWER_S} s; medians of {repeats} runs"
    harness.print_table(title, ["figure", "measured", "budget", ""], rows)


if __name__ == "__main__":
    main()
