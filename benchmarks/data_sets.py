"""After a change of gem_core.data: resets, verdicts and memory on 60,000 rows, beside gem-llm's on the same rows.

(The file is not called ``datasets``, which would hide the library of that name.) Each side runs in a process of its
own, and the processes alternate. Ours is given the file, gem-llm the loaded data set, since it takes no file; its first
environment writes the prompts of all rows into a cache, and that time is not counted. Rows have 2 kB: a question, an
answer, and a solution that nobody reads. Each answer is another one. Memory is what the process holds for itself, pages
of mapped files apart, in addition for each further environment.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import harness

ROWS = 60_000
ENVS = 64
RESET_BUDGET_US = 100.0
MEMORY_BUDGET_KB = 100.0

_COMMON = """
import json, sys, time

path, envs = {path!r}, {envs}

def held_kb():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("RssAnon"))

def per_call_us(call, arguments):
    started = time.perf_counter()
    for argument in arguments:
        call(*argument)
    return (time.perf_counter() - started) / len(arguments) * 1e6

def measure(make):
    env = make()
    env.reset()
    before = held_kb()
    started = time.perf_counter()
    others = [make() for _ in range(envs - 1)]
    make_us = (time.perf_counter() - started) / len(others) * 1e6
    for other in others:
        other.reset()
    each_kb = (held_kb() - before) / len(others)
    reset_us = per_call_us(env.reset, [()] * 5000)
    answers = [(f"So <answer>The number {{n}}, {{'one' * (n % 2)}}.</answer>",) for n in range(5000)]
    step_us = per_call_us(env.step, answers)
    print(json.dumps({{"make_us": make_us, "each_kb": each_kb, "reset_us": reset_us, "step_us": step_us}}))
"""

_OURS = """
import gem_qa

measure(lambda: gem_qa.QAEnv(dataset_name=path, question_key="problem"))
"""

_PEER = """
import datasets

datasets.disable_progress_bars()
from gem.envs.qa_env import QaEnv

rows = datasets.load_dataset("parquet", data_files=path, split="train", cache_dir=path + ".cache")
measure(lambda: QaEnv(dataset=rows, question_key="problem"))
"""

_WRITE_PARQUET = """
import datasets

datasets.disable_progress_bars()
datasets.Dataset.from_json({lines!r}, cache_dir={lines!r} + ".cache").to_parquet({parquet!r})
"""


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    with tempfile.TemporaryDirectory() as folder:
        lines, parquet = Path(folder, "rows.jsonl"), Path(folder, "rows.parquet")
        write_rows(lines)
        harness.run_once(harness.snippet(sides.ours, _WRITE_PARQUET.format(lines=str(lines), parquet=str(parquet))))
        cases = {
            "gem-qa, JSON lines": harness.snippet(sides.ours, _COMMON.format(path=str(lines), envs=ENVS) + _OURS),
            "gem-qa, Parquet": harness.snippet(sides.ours, _COMMON.format(path=str(parquet), envs=ENVS) + _OURS),
        }
        if peer_can_start(sides.peer):
            code = _COMMON.format(path=str(parquet), envs=ENVS) + _PEER
            cases["gem-llm"] = harness.snippet(sides.peer, code)
        results = harness.measure(cases, repeats=min(sides.repeats, 5), warm_up=1)
    show(results)


def write_rows(path: Path) -> None:
    """Write the rows."""
    with path.open("w", encoding="utf-8") as file:
        for number in range(ROWS):
            words = f"the number {number % 5000}, one."
            row = {"problem": f"{number}: " + "a word " * 100, "answer": words, "solution": "step " * 250}
            file.write(json.dumps(row) + "\n")


def peer_can_start(python: str) -> bool:
    """Tell whether the peer's environment has what its class imports."""
    figures = harness.run_once(
        harness.snippet(
            python,
            "import importlib.util, json\n"
            "print(json.dumps({'there': float(importlib.util.find_spec('datasets') is not None)}))",
        )
    )
    return bool(figures["there"])


def show(results: dict[str, harness.Case]) -> None:
    """Print the table, and whether ours is within its budgets."""
    figures = ("reset_us", "step_us", "make_us", "each_kb")
    rows = [[name, *(f"{case.median(figure):,.1f}" for figure in figures)] for name, case in results.items()]
    header = ["", "reset, us", "verdict, us", "one more, us", "its memory, kB"]
    harness.print_table(f"{ROWS:,} rows, {ENVS} environments", header, rows)
    for name in ("gem-qa, JSON lines", "gem-qa, Parquet"):
        reset = harness.verdict(results[name].median("reset_us"), RESET_BUDGET_US)
        memory = harness.verdict(results[name].median("each_kb"), MEMORY_BUDGET_KB)
        print(f"  {name}: a reset under {RESET_BUDGET_US:.0f} us: {reset}; memory of one more: {memory}")
    if "gem-llm" not in results:
        print("  gem-llm's QaEnv needs the package datasets, which is not installed beside it")


if __name__ == "__main__":
    main()
