"""After a change of gem_core.vector: steps a second of fast environments, the cost of autoreset, and memory.

Every side steps the same game with the same fixed actions. Beside ours stand the peer, gem-llm, and Gymnasium's
``SyncVectorEnv`` around our environment. What waits or computes for long is measured in ``vector_waiting.py`` and
``vector_processes.py``.
"""

from __future__ import annotations

import harness

SIZES = (1, 64, 512, 4096)
TIMES_PEER_ASYNC = 5
TIMES_PEER_LOOP = 1
MEMORY_BUDGET_KIB = 16
MOST_REPEATS = 3  # a run of all sides takes twenty seconds
MEMORY_ENVS = 4096

OURS = """
import gem_core as gem
def make(env_id, n):
    return gem.make_vec(env_id, n, backend={backend!r})
"""
PEERS = """
import gem
def make(env_id, n):
    return gem.make_vec([env_id] * n, async_mode={async_mode})
"""
GYMNASIUMS = """
from gymnasium.vector import AutoresetMode, SyncVectorEnv
import gem_core as gem
def make(env_id, n):
    return SyncVectorEnv([lambda: gem.make(env_id)] * n, autoreset_mode=AutoresetMode.SAME_STEP)
"""
# No vector environment at all: what is left is the environment's own time.
LOOPS = """
import {module} as gem
class Loop:
    def __init__(self, envs):
        self.envs = envs
    def reset(self):
        return [env.reset() for env in self.envs]
    def step(self, actions):
        results = []
        for env, action in zip(self.envs, actions):
            result = env.step(action)
            if result[2] or result[3]:
                env.reset()
            results.append(result)
        return results
def make(env_id, n):
    return Loop([gem.make(env_id) for _ in range(n)])
"""

STEPS = f"""
import json, time
figures = {{}}
for n in {SIZES}:
    vec = make("game:GuessTheNumber-v0-hard", n)
    count = 7 * max(1, 300 // n)  # whole episodes, since their ends cost most
    actions = [[f"\\\\boxed{{{{{{(7 * k + i) % 50 + 1}}}}}}" for i in range(n)] for k in range(count)]
    vec.reset()
    rounds = []
    for _ in range(5 if n < 4096 else 2):
        started = time.perf_counter()
        for batch in actions:
            vec.step(batch)
        rounds.append(time.perf_counter() - started)
    figures[str(n)] = n * count / min(rounds)  # what else the machine does only makes rounds longer
    del vec
print(json.dumps(figures))
"""

TURN_ENV = """
class TurnEnv(gem.Env):
    ends = True
    def __init__(self, **more):
        super().__init__()
    def reset(self, seed=None, **more):
        super().reset(seed=seed)
        return "Once more.", {}
    def step(self, action):
        return "Well done.", 1.0, self.ends, False, {}
class EndlessEnv(TurnEnv):
    ends = False
"""
REGISTERED = """
gem.register("bench:Turn-v0", TurnEnv)
gem.register("bench:Endless-v0", EndlessEnv)
"""
RESETS = """
import json, time
def seconds_per_step(env_id):
    vec, actions = make(env_id, 512), ["go on"] * 512
    vec.reset()
    vec.step(actions)
    started = time.perf_counter()
    for _ in range(24):
        vec.step(actions)
    return (time.perf_counter() - started) / 24 / 512
figures = {"endless": seconds_per_step("bench:Endless-v0"), "turn": seconds_per_step("bench:Turn-v0")}
print(json.dumps({**figures, "reset": figures["turn"] - figures["endless"]}))
"""

MEMORY = f"""
import gc, json, os
def used():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
def begun(n):
    vec = make("game:GuessTheNumber-v0-hard", n)
    vec.reset()
    vec.step(["\\\\boxed{{25}}"] * n)
    return vec
one, before = begun(1), used()
many, after = begun({MEMORY_ENVS}), used()
print(json.dumps({{"each": (after - before) / {MEMORY_ENVS}}}))
"""


def main() -> None:
    """Measure and print the tables."""
    sides = harness.arguments()
    measure_steps(sides)
    measure_resets(sides)
    measure_memory(sides)


def measure_steps(sides: harness.Sides) -> None:
    """Compare steps a second over the number of environments."""
    repeats = min(sides.repeats, MOST_REPEATS)
    makers = {
        "ours, async": (sides.ours, OURS.format(backend="async")),
        "ours, sync": (sides.ours, OURS.format(backend="sync")),
        "ours, process": (sides.ours, OURS.format(backend="process")),
        "our environments, bare loop": (sides.ours, LOOPS.format(module="gem_core")),
        "Gymnasium's sync, our environments": (sides.ours, GYMNASIUMS),
        "gem-llm, async": (sides.peer, PEERS.format(async_mode=True)),
        "gem-llm, sync": (sides.peer, PEERS.format(async_mode=False)),
        "gem-llm's environments, bare loop": (sides.peer, LOOPS.format(module="gem")),
    }
    results = harness.measure(
        {name: harness.snippet(python, make + STEPS) for name, (python, make) in makers.items()},
        repeats=repeats,
        warm_up=1,
    )
    rows = [[name, *(f"{case.median(str(n)):,.0f}" for n in SIZES)] for name, case in results.items()]
    title = (
        f"GuessTheNumber, steps a second by number of environments; medians of {repeats} runs, each its fastest round"
    )
    harness.print_table(title, ["side", *map(str, SIZES)], rows)
    ours = results["ours, async"]
    for peer, least in (("gem-llm, async", TIMES_PEER_ASYNC), ("gem-llm, sync", TIMES_PEER_LOOP)):
        ratios = {n: ours.median(str(n)) / results[peer].median(str(n)) for n in SIZES}
        shown = ", ".join(f"{ratio:.1f}" for ratio in ratios.values())
        print(f"  ratio of ours, async, to {peer}: {shown};", end=" ")
        print(f"budget: at least {least} with 512: {harness.verdict(ratios[512], least, at_least=True)}")
    for name in ("gem-llm's environments, bare loop", "Gymnasium's sync, our environments"):
        shown = ", ".join(f"{ours.median(str(n)) / results[name].median(str(n)):.1f}" for n in SIZES)
        print(f"  ratio of ours, async, to {name}: {shown}")


def measure_resets(sides: harness.Sides) -> None:
    """Compare environments whose every turn is the last with such as never end."""
    repeats = min(sides.repeats, MOST_REPEATS)
    env = TURN_ENV + REGISTERED
    results = harness.measure(
        {
            "ours, auto": harness.snippet(sides.ours, OURS.format(backend="auto") + env + RESETS),
            "Gymnasium's sync, our environments": harness.snippet(sides.ours, GYMNASIUMS + env + RESETS),
            "gem-llm, sync": harness.snippet(sides.peer, PEERS.format(async_mode=False) + env + RESETS),
        },
        repeats=repeats,
        warm_up=1,
    )
    names = ("endless", "turn", "reset")
    rows = [[name, *(f"{case.median(figure) * 1e6:.2f}" for figure in names)] for name, case in results.items()]
    title = f"Autoreset with 512 environments that do nothing, µs; medians of {repeats} alternating runs"
    harness.print_table(title, ["side", "step, never over", "step, always over", "each reset"], rows)
    print("  only ours gives each episode a seed of its own, and only ours and Gymnasium's keep the last observation")


def measure_memory(sides: harness.Sides) -> None:
    """Compare the resident memory of many environments with that of one."""
    repeats = min(sides.repeats, MOST_REPEATS)
    results = harness.measure(
        {
            "ours, auto": harness.snippet(sides.ours, OURS.format(backend="auto") + MEMORY),
            "Gymnasium's sync, our environments": harness.snippet(sides.ours, GYMNASIUMS + MEMORY),
            "gem-llm, async": harness.snippet(sides.peer, PEERS.format(async_mode=True) + MEMORY),
            "gem-llm, sync": harness.snippet(sides.peer, PEERS.format(async_mode=False) + MEMORY),
        },
        repeats=repeats,
        warm_up=0,
    )
    each = {name: case.median("each") / 1024 for name, case in results.items()}
    title = f"Resident memory of each of {MEMORY_ENVS} environments above one, KiB; medians of {repeats} runs"
    harness.print_table(title, ["side", "KiB each"], [[name, f"{kib:.1f}"] for name, kib in each.items()])
    print(
        f"  budget: ours under {MEMORY_BUDGET_KIB} KiB: {harness.verdict(each['ours, auto'], MEMORY_BUDGET_KIB)}; "
        f"gem-llm, sync, takes {each['gem-llm, sync'] / each['ours, auto']:.2f} times as much"
    )


if __name__ == "__main__":
    main()
