"""After a change of gem-terminal's engine: how long a task takes, beside the container client driven by hand.

gem-llm's own environment for such tasks is not measured: it runs the trials of another program, which needs Python
3.12, Docker Compose, and tmux and asciinema in each image. In its place stands what it would need at least: ``docker
run`` for a reset, ``docker exec`` for a command, and for the end ``docker cp`` of the tests, ``docker exec`` of them
and of ``cat`` of the reward, and ``docker rm``. That has no shell that lives on, and no time limit.

*Ready*: a reset that finds a machine in the pool. *Cold*: one that waits for the machine to be started, its image being
there. *Command*: ``true`` in the open shell. *Finish*: the tests, and the end. *Sixteen*: as many episodes at once,
each of a reset, a command and the end, until all containers are gone; by hand there is but ``run``, the tests by
``exec`` as if the image had them, and ``rm``. Needs an engine; ``GEM_TERMINAL_BASE_IMAGE`` names the image, which has
bash.
"""

from __future__ import annotations

import os
import shutil
import subprocess

import harness

REPEATS = 3
BASE = os.environ.get("GEM_TERMINAL_BASE_IMAGE", "python:3.12-slim-bookworm")

OURS = """
import json, statistics, tempfile, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import gem_core as gem

def timed(work, times):
    started = time.perf_counter()
    result = work()
    times.append(time.perf_counter() - started)
    return result

def make(task, **options):
    return gem.make("terminal:Folder", path=str(task), **options)

def whole(env):
    env.reset()
    env.step("<bash>true</bash>")
    assert env.step("<finish/>")[1] == 1.0
    env.close()

with tempfile.TemporaryDirectory() as name:
    task = Path(name, "task")
    for folder in ("environment", "tests"):
        (task / folder).mkdir(parents=True)
    (task / "task.toml").write_text('version = "1.0"')
    (task / "instruction.md").write_text("Do nothing.")
    dockerfile = "ARG BASE=python:3.12-slim-bookworm\\nFROM ${{BASE}}\\nWORKDIR /app\\n"
    (task / "environment/Dockerfile").write_text(dockerfile)
    (task / "tests/test.sh").write_text("echo 1 >/logs/verifier/reward.txt")
    figures = {{}}
    for what, size in (("cold", 0), ("ready", 1)):
        env = make(task, pool_size=size, prestart=size > 0)
        env.reset()
        resets, steps, ends = [], [], []
        for _ in range(8):
            time.sleep(1.0)  # the agent thinks, and the next machine is started meanwhile
            timed(env.reset, resets)
            for _ in range(25):
                observation = timed(lambda: env.step("<bash>true</bash>"), steps)[0]
                assert observation.startswith("[exit code 0]"), observation
            assert timed(lambda: env.step("<finish/>"), ends)[1] == 1.0
        env.close()
        figures |= {{f"{{what}}_s": statistics.median(resets), "command_s": statistics.median(steps),
                    "finish_s": statistics.median(ends)}}
    sixteen = []
    for _ in range(3):
        envs = [make(task, pool_size=0) for _ in range(16)]
        with ThreadPoolExecutor(16) as pool:
            timed(lambda: list(pool.map(whole, envs)), sixteen)
    figures["sixteen_s"] = statistics.median(sixteen)
print(json.dumps(figures))
"""

BY_HAND = """
import json, statistics, subprocess, tempfile, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

TEST = "mkdir -p /logs/verifier; echo 1 >/logs/verifier/reward.txt"

def docker(*words):
    return subprocess.run(["docker", *words], check=True, capture_output=True, text=True).stdout.strip()

def timed(work, times):
    started = time.perf_counter()
    result = work()
    times.append(time.perf_counter() - started)
    return result

def run():
    return docker("run", "--detach", "--network", "none", "--memory", "2g", {base!r}, "sleep", "infinity")

def finish(container, tests):
    docker("cp", tests, container + ":/tests")
    docker("exec", container, "bash", "/tests/test.sh")
    assert docker("exec", container, "cat", "/logs/verifier/reward.txt") == "1"
    docker("rm", "--force", container)

def whole(_):
    container = run()
    docker("exec", container, "bash", "-c", TEST)
    docker("rm", "--force", container)

runs, commands, ends, sixteen = [], [], [], []
with tempfile.TemporaryDirectory() as tests:
    Path(tests, "test.sh").write_text(TEST)
    for _ in range(8):
        container = timed(run, runs)
        for _ in range(10):
            timed(lambda: docker("exec", container, "bash", "-c", "true"), commands)
        timed(lambda: finish(container, tests), ends)
for _ in range(3):
    with ThreadPoolExecutor(16) as pool:
        timed(lambda: list(pool.map(whole, range(16))), sixteen)
print(json.dumps({{"cold_s": statistics.median(runs), "command_s": statistics.median(commands),
                  "finish_s": statistics.median(ends), "sixteen_s": statistics.median(sixteen)}}))
"""

ROWS = (
    ("reset, machine ready", "ready_s"),
    ("reset, cold", "cold_s"),
    ("command", "command_s"),
    ("tests, and the end", "finish_s"),
    ("sixteen episodes at once", "sixteen_s"),
)


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    if (
        shutil.which("docker") is None
        or subprocess.run(["docker", "info"], capture_output=True, check=False).returncode
    ):
        print("Terminal tasks: not measured, since no container engine answers. Start one, or set DOCKER_HOST.")
        return
    cases = {
        "docker": harness.snippet(sides.ours, OURS.format()),
        "by hand": harness.snippet(sides.ours, BY_HAND.format(base=BASE)),
    }
    results = harness.measure(cases, repeats=min(sides.repeats, REPEATS), warm_up=1)
    rows = []
    for what, name in ROWS:
        rows.append([what, *(_cell(results[case], name) for case in cases)])
    harness.print_table("Terminal tasks: gem-terminal, and the container client by hand", ["", *cases], rows)
    for what, name, most in (("<finish/>", "finish_s", 1.2), ("sixteen at once", "sixteen_s", 1.5)):
        ratio = results["docker"].median(name) / results["by hand"].median(name)
        print(f"  budget: {what} at most {most:g} times by hand: {ratio:.2f}, {harness.verdict(ratio, most)}")
    ready = results["docker"].median("ready_s")
    print(f"  budget: a reset under 1 s: {harness.verdict(ready, 1.0)}")


def _cell(case: harness.Case, name: str) -> str:
    return f"{case.median(name) * 1e3:.1f} ms" if name in case.figures else "-"


if __name__ == "__main__":
    main()
