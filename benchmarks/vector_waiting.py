"""After a change of waiting in gem_core.vector: a batch that waits 0.1 s, and what one that waits for 5 s holds up.

Beside ours stand the peer, gem-llm, with its threads, and Gymnasium's ``AsyncVectorEnv`` around our environment, which
starts a process for each: 512 of them take some 2 GB.
"""

from __future__ import annotations

import harness

SIZES = (64, 512)
SLEEP_S, STRAGGLER_S = 0.1, 5.0
BATCH_BUDGET_S, RECV_BUDGET_S = 0.11, 0.2
MOST_REPEATS = 2  # a run of all sides takes fifteen seconds, all of it waiting

SLEEPERS = """
import asyncio, json, statistics, time
class SleepEnv(gem.Env):
    concurrency = "thread"
    def __init__(self, **more):
        super().__init__()
    def reset(self, seed=None, **more):
        super().reset(seed=seed)
        return "Wait.", {}
    def step(self, action):
        time.sleep(float(action))
        return "Waited.", 0.0, False, False, {}
gem.register("bench:Sleep-v0", SleepEnv)
"""
ASYNC_SLEEPERS = (
    SLEEPERS
    + """
class AsyncSleepEnv(gem.AsyncEnv):
    async def reset_async(self, seed=None, options=None):
        await super().reset_async(seed=seed)
        return "Wait.", {}
    async def step_async(self, action):
        await asyncio.sleep(float(action))
        return "Waited.", 0.0, False, False, {}
gem.register("bench:AsyncSleep-v0", AsyncSleepEnv)
"""
)
BATCHES = """
figures = {{}}
for n in {sizes}:
    vec = make(n)
    vec.reset()
    vec.step(["0.1"] * n)  # starts the threads
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        vec.step(["0.1"] * n)
        seconds.append(time.perf_counter() - started)
    figures[str(n)] = statistics.median(seconds)
    if hasattr(vec, "close"):
        vec.close()
print(json.dumps(figures))
"""
OURS = """
def make(n):
    return gem.make_vec({env_id!r}, n)
"""
PEERS = """
def make(n):
    return gem.make_vec(["bench:Sleep-v0"] * n, async_mode=True)
"""
GYMNASIUMS = """
from gymnasium.vector import AsyncVectorEnv
def make(n):
    return AsyncVectorEnv([lambda: gem.make("bench:Sleep-v0")] * n, shared_memory=False)
"""

STRAGGLER = f"""
vec = make(64)
vec.reset()
actions = ["{STRAGGLER_S}"] + ["{SLEEP_S}"] * 63
vec.step(["0.01"] * 64)  # starts the threads
started = time.perf_counter()
"""
RECEIVED = f"""
vec.send(actions)
received, seconds = vec.recv(min_envs=63), time.perf_counter() - started
# They go on, while the first still waits.
started, batches = time.perf_counter(), []
for _ in range(5):
    vec.send({{slot: "{SLEEP_S}" for slot in received.slots}})
    received = vec.recv(min_envs=63)
    batches.append(time.perf_counter() - started)
    started = time.perf_counter()
print(json.dumps({{"first": seconds, "next": statistics.median(batches)}}))
"""
STEPPED = """
vec.step(actions)
print(json.dumps({"first": time.perf_counter() - started}))
"""


def main() -> None:
    """Measure and print the tables."""
    sides = harness.arguments()
    measure_sleepers(sides)
    measure_straggler(sides)


def measure_sleepers(sides: harness.Sides) -> None:
    """Compare the median batch of environments that wait."""
    repeats = min(sides.repeats, MOST_REPEATS)
    ours = "import gem_core as gem" + ASYNC_SLEEPERS
    batches = BATCHES.format(sizes=SIZES)
    results = harness.measure(
        {
            "ours, concurrency thread": harness.snippet(
                sides.ours, ours + OURS.format(env_id="bench:Sleep-v0") + batches
            ),
            "ours, concurrency async": harness.snippet(
                sides.ours, ours + OURS.format(env_id="bench:AsyncSleep-v0") + batches
            ),
            "gem-llm, async": harness.snippet(sides.peer, "import gem" + SLEEPERS + PEERS + batches),
            "Gymnasium's async, our environments": harness.snippet(sides.ours, ours + GYMNASIUMS + batches),
        },
        repeats=repeats,
        warm_up=0,
    )
    rows = [[name, *(f"{case.median(str(n)):.4f}" for n in SIZES)] for name, case in results.items()]
    title = f"Environments that wait {SLEEP_S} s, median batch in s; medians of {repeats} alternating runs"
    harness.print_table(title, ["side", *(f"{n} of them" for n in SIZES)], rows)
    for name in ("ours, concurrency thread", "ours, concurrency async"):
        value = results[name].median(str(SIZES[0]))
        print(f"  budget: {name}, 64 in under {BATCH_BUDGET_S} s: {harness.verdict(value, BATCH_BUDGET_S)}")


def measure_straggler(sides: harness.Sides) -> None:
    """Compare the time until all but the slowest are back."""
    repeats = min(sides.repeats, MOST_REPEATS)
    ours = "import gem_core as gem" + ASYNC_SLEEPERS
    results = harness.measure(
        {
            "ours, threads, recv(min_envs=63)": harness.snippet(
                sides.ours, ours + OURS.format(env_id="bench:Sleep-v0") + STRAGGLER + RECEIVED
            ),
            "ours, tasks, recv(min_envs=63)": harness.snippet(
                sides.ours, ours + OURS.format(env_id="bench:AsyncSleep-v0") + STRAGGLER + RECEIVED
            ),
        },
        repeats=repeats,
        warm_up=0,
    )
    # They wait for the slowest, every time: once is enough to see it.
    results |= harness.measure(
        {
            "gem-llm, async, step": harness.snippet(sides.peer, "import gem" + SLEEPERS + PEERS + STRAGGLER + STEPPED),
            "Gymnasium's async, step": harness.snippet(sides.ours, ours + GYMNASIUMS + STRAGGLER + STEPPED),
        },
        repeats=1,
        warm_up=0,
    )
    rows = [
        [name, f"{case.median('first'):.4f}", f"{case.median('next'):.4f}" if "next" in case.figures else ""]
        for name, case in results.items()
    ]
    title = f"63 environments that wait {SLEEP_S} s, and one that waits {STRAGGLER_S:.0f} s; medians of {repeats} runs"
    harness.print_table(title, ["side", "until 63 are back, s", "each batch of 63 from then on, s"], rows)
    for name in list(results)[:2]:
        value = results[name].median("first")
        print(f"  budget: {name} under {RECV_BUDGET_S} s: {harness.verdict(value, RECV_BUDGET_S)}")


if __name__ == "__main__":
    main()
