"""After a change of worker processes: how much faster computing gets, and what large observations cost on the way.

Beside ours stand the peer, gem-llm, whose threads share one interpreter, and Gymnasium's ``AsyncVectorEnv`` around our
environment, which starts a process for each.
"""

from __future__ import annotations

import subprocess

import harness

TIMES_SYNC, CORES = 1.7, 2
MOST_REPEATS = 3  # a run of all sides takes eight seconds
MEBIBYTES = (0.0625, 1, 4, 16)
LINEAR = 2.0
"""How much longer a mebibyte may take in a message four times as large; four times would be quadratic."""

WORKERS = """
class WorkEnv(gem.Env):
    concurrency = "process"
    def __init__(self, **more):
        super().__init__()
    def reset(self, seed=None, **more):
        super().reset(seed=seed)
        return "Work.", {}
    def step(self, action):
        total = 0
        for number in range(int(action)):
            total += number * number % 7
        return str(total), 0.0, False, False, {}
gem.register("bench:Work-v0", WorkEnv)
"""
OURS = """
def make(n):
    return gem.make_vec("bench:Work-v0", n, backend={backend!r})
"""
PEERS = """
def make(n):
    return gem.make_vec(["bench:Work-v0"] * n, async_mode={async_mode})
"""
GYMNASIUMS = """
from gymnasium.vector import AsyncVectorEnv
def make(n):
    return AsyncVectorEnv([lambda: gem.make("bench:Work-v0")] * n, shared_memory=False)
"""
STEPS = """
import json, time
vec, actions = make(8), ["100000"] * 8  # about 5 ms each
vec.reset()
vec.step(actions)
rounds = []
for _ in range(15):
    started = time.perf_counter()
    vec.step(actions)
    rounds.append(time.perf_counter() - started)
print(json.dumps({"step": min(rounds) / 8}))  # what else the machine does only makes rounds longer
if hasattr(vec, "close"):
    vec.close()
"""
# What the machine itself gives at this moment: two bare processes, with nothing between them. Each leads a session, as
# our workers do: on a busy machine Linux may share the processor out by session.
BARE = """
import json, multiprocessing, os, time
env = WorkEnv()
def work(number):
    for _ in range(4):
        env.step("100000")
with multiprocessing.get_context("fork").Pool(2, os.setsid) as pool:
    rounds = []
    for _ in range(15):
        started = time.perf_counter()
        pool.map(work, range(2), chunksize=1)
        rounds.append(time.perf_counter() - started)
    print(json.dumps({"step": min(rounds) / 8}))
"""

LARGE = """
import json, time
import gem_core as gem
class LargeEnv(gem.Env):
    def reset(self, seed=None, **more):
        super().reset(seed=seed)
        return "Say how much.", {}
    def step(self, action):
        kind, _, size = action.partition(" ")
        if kind == "text":
            return "a" * int(float(size) * 2**20), 0.0, False, False, {}
        if kind == "take":
            return str(len(size)), 0.0, False, False, {}
        from PIL import Image
        side = int((float(size) * 2**20 / 3) ** 0.5)
        image = Image.new("RGB", (side, side))
        return [{"type": "image", "image": image}], 0.0, False, False, {}
gem.register("bench:Large-v0", LargeEnv)
"""
OUR_LARGE = """
vec = gem.make_vec("bench:Large-v0", 2, backend=("process", {"workers": 2}))
"""
GYMNASIUMS_LARGE = """
from gymnasium.vector import AsyncVectorEnv
vec = AsyncVectorEnv([lambda: gem.make("bench:Large-v0")] * 2, shared_memory=False)
"""
MESSAGES = f"""
def seconds(action, size):
    count = max(2, int(16 / size) if size >= 1 else 32)
    vec.step([action] * 2)
    started = time.perf_counter()
    for _ in range(count):
        vec.step([action] * 2)
    return (time.perf_counter() - started) / count / 2
vec.reset()
figures = {{}}
for size in {MEBIBYTES}:
    figures[f"text {{size}}"] = seconds(f"text {{size}}", size)
    figures[f"take {{size}}"] = seconds("take " + "a" * int(size * 2**20), size)
    if IMAGES:
        figures[f"image {{size}}"] = seconds(f"image {{size}}", size)
print(json.dumps(figures))
vec.close()
"""


def main() -> None:
    """Measure and print the tables."""
    sides = harness.arguments()
    measure_work(sides)
    measure_messages(sides)


def measure_work(sides: harness.Sides) -> None:
    """Compare steps of pure Python in one process and in several."""
    repeats = min(sides.repeats, MOST_REPEATS)
    ours = "import gem_core as gem" + WORKERS
    peers = "import gem" + WORKERS
    results = harness.measure(
        {
            "ours, sync": harness.snippet(sides.ours, ours + OURS.format(backend="sync") + STEPS),
            "ours, process, 2 workers": harness.snippet(
                sides.ours, ours + OURS.format(backend=("process", {"workers": CORES})) + STEPS
            ),
            "two bare processes": harness.snippet(sides.ours, ours + BARE),
            "Gymnasium's async, 8 processes": harness.snippet(sides.ours, ours + GYMNASIUMS + STEPS),
            "gem-llm, sync": harness.snippet(sides.peer, peers + PEERS.format(async_mode=False) + STEPS),
            "gem-llm, async": harness.snippet(sides.peer, peers + PEERS.format(async_mode=True) + STEPS),
        },
        repeats=repeats,
        warm_up=0,
    )
    sync = results["ours, sync"].median("step")
    rows = [
        [name, f"{case.median('step') * 1e3:.2f}", f"{sync / case.median('step'):.2f}"]
        for name, case in results.items()
    ]
    title = f"8 environments that compute in pure Python; medians of {repeats} runs, each its fastest of 15 batches"
    harness.print_table(title, ["side", "ms a step", "times our sync"], rows)
    process = results["ours, process, 2 workers"].median("step")
    said = harness.verdict(sync / process, TIMES_SYNC, at_least=True)
    print(f"  budget: process at least {TIMES_SYNC} times sync on {CORES} cores: {said};", end=" ")
    print(f"the machine gives {sync / results['two bare processes'].median('step'):.2f} times while this runs")


def measure_messages(sides: harness.Sides) -> None:
    """Compare what a mebibyte takes in small and in large messages."""
    repeats = min(sides.repeats, MOST_REPEATS)
    images = not subprocess.run([sides.ours, "-c", "import PIL"], capture_output=True, check=False).returncode
    messages = f"IMAGES = {images}" + MESSAGES
    results = harness.measure(
        {
            "ours, process": harness.snippet(sides.ours, LARGE + OUR_LARGE + messages),
            "Gymnasium's async": harness.snippet(sides.ours, LARGE + GYMNASIUMS_LARGE + messages),
        },
        repeats=repeats,
        warm_up=0,
    )
    what = {"text": "text observed", "take": "text as action"} | ({"image": "image observed"} if images else {})
    rows = []
    worst = 0.0
    for name, case in results.items():
        for kind, said in what.items():
            rates = [case.median(f"{kind} {size}") * 1e3 / size for size in MEBIBYTES]
            rows.append([f"{name}, {said}", *(f"{rate:.2f}" for rate in rates)])
            if name == "ours, process":
                worst = max(worst, rates[-1] / rates[-2])
    title = f"Messages between two workers and the host, ms a MiB by size; medians of {repeats} alternating runs"
    harness.print_table(title, ["side", *(f"{size:g} MiB" for size in MEBIBYTES)], rows)
    print(
        f"  budget: linear, a MiB of {MEBIBYTES[-1]} takes under {LINEAR:g} times as long as one of {MEBIBYTES[-2]}: "
        f"{harness.verdict(worst, LINEAR)} ({worst:.2f})"
    )
    if not images:
        print("  images skipped: the extra 'images' is not installed; 'make lint' installs it")


if __name__ == "__main__":
    main()
