"""After a change of gem-code's runner: how many programs are graded in a second, beside gem-llm's CodeEnv.

The programs are those of code:Sample that read standard input: for each problem the right one and one that is wrong, on
the same tests, 12 at most. gem-llm runs them as it does by default: without a sandbox, five tests at a time, each in a
new interpreter. Ours run in the strongest sandbox that works here, four tests at a time. *One* is a single environment
that answers one response after another; *many* is 64 environments at once: ours as a vector environment, gem-llm's in
64 threads. gem-llm runs every test of a wrong program, ours stop at the first failure, so right programs are measured
apart. Functions with assertions are ours alone: gem-llm cannot grade them.

Both sides must agree with what is known of each program, or the benchmark fails.
"""

from __future__ import annotations

import importlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import harness

PROBLEMS = Path(__file__).resolve().parent.parent / "plugins" / "gem-code" / "tests"

COMMON = """
import json, statistics, sys, time
work = json.load(open({path!r}))

def timed(step, items):
    times = []
    for item in items:
        started = time.perf_counter()
        reward = step(item)
        times.append(time.perf_counter() - started)
        if (reward == 1.0) != item["right"]:
            sys.exit(f"a wrong verdict on {{item['id']}}: {{reward}}")
    return sum(times) / len(times)
"""

OURS = (
    COMMON
    + """
import gem_core as gem
from gem_code import CodeEnv

def rows(items):
    return [{{"problem": i["problem"], "tests": i["tests"], "entry_point": i["entry"]}} for i in items]

def one(items):
    env = CodeEnv(rows(items))
    place = {{i["id"]: n for n, i in enumerate(items)}}
    def step(item):
        env.reset(options={{"index": place[item["id"]]}})
        return env.step(item["response"])[1]
    step(items[0])
    return timed(step, items)

def many(items):
    items = (items * 64)[: max(64, len(items) // 64 * 64)]
    gem.register("bench:Code", "gem_code:CodeEnv", rows=rows(items))
    vec = gem.make_vec("bench:Code", num_envs=64, seed=0)
    infos = vec.reset()[1]
    started = time.perf_counter()
    step = vec.step([items[info["index"]]["response"] for info in infos])
    spent = time.perf_counter() - started
    wrong = [i for i, info in enumerate(infos) if (step.rewards[i] == 1.0) != items[info["index"]]["right"]]
    if wrong:
        sys.exit("a wrong verdict")
    vec.close()
    return spent / 64

programs = [i for i in work if not i["entry"]]
right = [i for i in programs if i["right"]]
functions = [i for i in work if i["entry"]]
figures = {{"right_s": one(right), "wrong_s": one([i for i in programs if not i["right"]])}}
figures["functions_s"] = one(functions)
figures["many_s"] = many(right)
print(json.dumps(figures))
"""
)

PEER = (
    COMMON
    + """
import os, random
from concurrent.futures import ThreadPoolExecutor
import datasets
from gem.envs.code_env import CodeEnv
os.environ["PATH"] = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]
os.chdir({folder!r})

def env_of(item):
    row = {{"problem": item["problem"], "tests": item["tests"]}}
    env = CodeEnv(dataset_name="taco", dataset=datasets.Dataset.from_list([row]), split="train")
    env.reset()
    return env

def one(items):
    envs = {{i["id"]: env_of(i) for i in items}}
    return timed(lambda item: envs[item["id"]].step(item["response"])[1], items)

def many(items):
    chosen = random.Random(0).choices(items, k=64)
    envs = [env_of(i) for i in chosen]
    with ThreadPoolExecutor(64) as pool:
        started = time.perf_counter()
        rewards = list(pool.map(lambda pair: pair[0].step(pair[1]["response"])[1], zip(envs, chosen)))
        spent = time.perf_counter() - started
    if any((reward == 1.0) != item["right"] for reward, item in zip(rewards, chosen)):
        sys.exit("a wrong verdict")
    return spent / 64

programs = [i for i in work if not i["entry"]]
right = [i for i in programs if i["right"]]
figures = {{"right_s": one(right), "wrong_s": one([i for i in programs if not i["right"]])}}
figures["many_s"] = many(right)
print(json.dumps(figures))
"""
)

FIGURES = {"right_s": "right program", "wrong_s": "wrong program", "many_s": "right, 64 at once"}


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "work.json")
        path.write_text(json.dumps(work()), encoding="utf-8")
        values = {"path": str(path), "folder": folder}
        cases = {
            "gem-code": harness.snippet(sides.ours, OURS.format(**values)),
            "gem-llm": harness.snippet(sides.peer, PEER.format(**values)),
        }
        # A round takes half a minute on two cores; three of them tell enough.
        results = harness.measure(cases, repeats=min(sides.repeats, 3), warm_up=0)
    ours, peer = results["gem-code"], results["gem-llm"]
    rows = []
    for figure, name in FIGURES.items():
        mine, theirs = ours.median(figure), peer.median(figure)
        rows.append([name, f"{1 / mine:.1f}", f"{1 / theirs:.1f}", f"{theirs / mine:.1f}"])
    rows.append(["function with assertions", f"{1 / ours.median('functions_s'):.1f}", "cannot", ""])
    harness.print_table("Programs graded in a second", ["", "gem-code", "gem-llm", "ratio"], rows)


def work() -> list[dict[str, Any]]:
    """Return the programs, with the tests of their problems and whether they are right."""
    sys.path.insert(0, str(PROBLEMS))
    build = importlib.import_module("problems.build")
    found = []
    for problem in build.PROBLEMS:
        wrong = next(iter(problem.wrong.values()))
        for right, code in ((True, problem.reference), (False, wrong)):
            found.append(
                {
                    "id": f"{problem.id} {right}",
                    "problem": problem.statement,
                    "tests": build.written_tests(problem),
                    "entry": problem.function,
                    "response": f"```python\n{code}```",
                    "right": right,
                }
            )
    return found


if __name__ == "__main__":
    main()
