"""After a change of the Python tool: how many short scripts run in a second, beside gem-llm's, and one call's time.

Both run the same scripts in the same run, one in six of which fails. The peer starts an interpreter for each call, and
a second one after a name that is not defined; without a sandbox, its default. Ours runs in the strongest that is to be
had, which is named. *One caller* waits for each call before the next; *sixteen callers* call at once: ours as
coroutines, the peer from threads.
"""

from __future__ import annotations

import harness

RATIO_BUDGET = 10.0
REPEATS = 5

SCRIPTS = [
    "print(1 + 1)",
    "print(sum(i * i for i in range(1000)))",
    "import math\nprint(math.comb(40, 20))",
    "import re\nprint(re.findall(r'\\d+', 'a1b22c333'))",
    "from fractions import Fraction\nprint(sum(Fraction(1, n) for n in range(1, 20)))",
    "print(undefined_name)",
]

OURS = """
import asyncio, json, statistics, time
from gem_tools.python import Limits, Pool

scripts = {scripts!r}
pool = Pool()
level = pool.start()
limits = Limits(wall_s=5)

async def many(count):
    gate = asyncio.Semaphore(16)
    async def one(number):
        async with gate:
            return await pool.arun(scripts[number % len(scripts)], limits=limits)
    return await asyncio.gather(*map(one, range(count)))

asyncio.run(many(60))
times = []
for number in range(120):
    started = time.perf_counter()
    outcome = pool.run(scripts[number % len(scripts)], limits=limits)
    times.append(time.perf_counter() - started)
    assert outcome.status == ("error" if number % len(scripts) == 5 else "ok"), outcome
started = time.perf_counter()
asyncio.run(many(600))
spent = time.perf_counter() - started
pool.close()
levels = {{"bubblewrap": 3, "docker": 2, "process": 1}}
print(json.dumps({{
    "one_s": statistics.median(times), "one_rate": len(times) / sum(times), "many_rate": 600 / spent,
    "level": levels[level],
}}))
"""

PEER = """
import json, os, statistics, sys, tempfile, time
from concurrent.futures import ThreadPoolExecutor
# It starts whatever 'python' is first on the PATH, in the current folder.
os.environ["PATH"] = os.path.dirname(sys.executable) + ":" + os.environ["PATH"]
os.chdir(tempfile.mkdtemp())
from gem.tools.python_code_tool import PythonCodeTool

scripts = {scripts!r}
tool = PythonCodeTool(timeout=5)

def one(number):
    return tool.execute_action("<python>" + scripts[number % len(scripts)] + "</python>")

times = []
for number in range(24):
    started = time.perf_counter()
    valid, error, observation, _ = one(number)
    times.append(time.perf_counter() - started)
    assert valid and error == (number % len(scripts) == 5), observation
with ThreadPoolExecutor(16) as threads:
    started = time.perf_counter()
    list(threads.map(one, range(48)))
    spent = time.perf_counter() - started
print(json.dumps({{"one_s": statistics.median(times), "one_rate": len(times) / sum(times), "many_rate": 48 / spent}}))
"""


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    results = harness.measure(
        {
            "gem_tools": harness.snippet(sides.ours, OURS.format(scripts=SCRIPTS)),
            "gem-llm": harness.snippet(sides.peer, PEER.format(scripts=SCRIPTS)),
        },
        repeats=min(sides.repeats, REPEATS),
        warm_up=1,
    )
    ours, peer = results["gem_tools"], results["gem-llm"]
    rows = []
    for name, figure in (("one caller", "one_rate"), ("sixteen callers", "many_rate")):
        mine, theirs = ours.median(figure), peer.median(figure)
        rows.append([name, f"{mine:.0f}/s", f"{theirs:.1f}/s", f"{mine / theirs:.1f}x"])
    mine, theirs = ours.median("one_s"), peer.median("one_s")
    rows.append(["median of one call", f"{mine * 1e3:.2f} ms", f"{theirs * 1e3:.1f} ms", f"{theirs / mine:.1f}x"])
    level = {3: "bubblewrap", 2: "docker", 1: "process"}[round(ours.median("level"))]
    title = f"Short scripts, ours in the sandbox {level}, the peer's in none"
    harness.print_table(title, ["", "gem_tools", "gem-llm", "ratio"], rows)
    ratio = min(ours.median(figure) / peer.median(figure) for figure in ("one_rate", "many_rate"))
    met = harness.verdict(ratio, RATIO_BUDGET, at_least=True)
    print(f"  budget: at least {RATIO_BUDGET:.0f} times the calls: {met}")


if __name__ == "__main__":
    main()
