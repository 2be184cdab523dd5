"""How long a reset and a command of a terminal task take, beside the container client driven by hand.

gem-llm's own environment for such tasks is not measured: it runs the trials of another program, which needs Python
3.12, Docker Compose, and tmux and asciinema in each image. In its place stands what it would need at least: ``docker
run`` for a reset, ``docker exec`` for a command, ``docker rm`` for the end. That has no shell that lives on, and no
time limit.

*Ready*: a reset that finds a machine in the pool. *Cold*: one that waits for the machine to be started, its image being
there. *Command*: ``true`` in the open shell. Needs an engine; ``GEM_TERMINAL_BASE_IMAGE`` names the image, which has
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
from pathlib import Path
import gem_core as gem

def timed(work, times):
    started = time.perf_counter()
    result = work()
    times.append(time.perf_counter() - started)
    return result

with tempfile.TemporaryDirectory() as name:
    task = Path(name, "task")
    for folder in ("environment", "tests"):
        (task / folder).mkdir(parents=True)
    (task / "task.toml").write_text('version = "1.0"')
    (task / "instruction.md").write_text("Do nothing.")
    (task / "environment/Dockerfile").write_text("ARG BASE=python:3.12-slim-bookworm\\nFROM ${{BASE}}\\n")
    (task / "tests/test.sh").write_text("echo 1 >/logs/verifier/reward.txt")
    figures = {{}}
    for what, size in (("cold", 0), ("ready", 1)):
        env = gem.make("terminal:Folder", path=str(task), backend={backend!r}, pool_size=size, prestart=size > 0)
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
print(json.dumps(figures))
"""

BY_HAND = """
import json, statistics, subprocess, time

def timed(words, times):
    started = time.perf_counter()
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    times.append(time.perf_counter() - started)
    return done.stdout.strip()

runs, commands, ends = [], [], []
start = ["docker", "run", "--detach", "--network", "none", "--memory", "512m", {base!r}, "sleep", "infinity"]
for _ in range(8):
    container = timed(start, runs)
    for _ in range(10):
        timed(["docker", "exec", container, "bash", "-c", "true"], commands)
    timed(["docker", "rm", "--force", container], ends)
print(json.dumps({{"cold_s": statistics.median(runs), "command_s": statistics.median(commands),
                  "remove_s": statistics.median(ends)}}))
"""


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
        "docker": harness.snippet(sides.ours, OURS.format(backend="docker")),
        "by hand": harness.snippet(sides.ours, BY_HAND.format(base=BASE)),
    }
    if shutil.which("bwrap"):
        cases["local"] = harness.snippet(sides.ours, OURS.format(backend="local"))
    results = harness.measure(cases, repeats=min(sides.repeats, REPEATS), warm_up=1)
    rows = []
    for what, name in (("reset, machine ready", "ready_s"), ("reset, cold", "cold_s"), ("command", "command_s")):
        cells = [
            f"{results[case].median(name) * 1e3:.1f} ms" if name in results[case].figures else "-" for case in cases
        ]
        rows.append([what, *cells])
    rows.append(["tests, and the end", *_ends(results, cases)])
    harness.print_table("Terminal tasks: gem-terminal, and the container client by hand", ["", *cases], rows)
    ready, by_hand = results["docker"].median("ready_s"), results["by hand"].median("cold_s")
    print(f"  a reset with a ready machine takes {by_hand / ready:.1f} times less than 'docker run'")
    print(f"  budget: a reset under 1 s: {harness.verdict(ready, 1.0)}")


def _ends(results: dict[str, harness.Case], cases: dict[str, list[str]]) -> list[str]:
    names = ["remove_s" if case == "by hand" else "finish_s" for case in cases]
    return [f"{results[case].median(name) * 1e3:.0f} ms" for case, name in zip(cases, names, strict=True)]


if __name__ == "__main__":
    main()
