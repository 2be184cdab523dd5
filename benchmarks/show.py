"""After a change of `gem show`: how soon it shows something of a large file, and how long its index takes. No peer.

The file is written to a temporary folder and deleted: ``python benchmarks/show.py --megabytes 1000``.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import harness

if TYPE_CHECKING:
    from gem_core import Episode

MOVES = "look around, then go north and open the second door on the left; "


def main() -> None:
    """Generate a file, measure each way to look at it, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_eval")
    parser.add_argument("--peer", help="not used: the peer has no such command")
    parser.add_argument("--megabytes", type=int, default=50, help="size of the file")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each command")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "large.jsonl")
        count = generate(path, options.megabytes * 1_000_000)
        print(f"\n{path.stat().st_size / 1e6:,.0f} MB, {count:,} episodes")
        measure(options.ours, path, count, options.repeats)


def generate(path: Path, size: int) -> int:
    """Write episodes of 10 turns, with sampled tokens, until the file has the size; return their number."""
    from gem_core import Episode, Response, Transition, write_episodes

    def episodes() -> Iterator[Episode]:
        for count in itertools.count():
            if count % 100 == 0 and path.stat().st_size >= size:
                return
            turns = [
                Transition(
                    f"Turn {turn}. " + MOVES * 12,
                    Response(MOVES * 3, token_ids=list(range(count % 7, 60)), finish_reason="stop"),
                    turn / 10,
                    turn == 9,
                    False,
                    {"feedback": MOVES, "correct": count % 3 == 0},
                )
                for turn in range(10)
            ]
            yield Episode(f"bench:Maze-v0-{count % 4}", count, turns[0].observation, {}, turns, "The end.")

    return write_episodes(path, episodes())


def measure(python: str, path: Path, count: int, repeats: int) -> None:
    """Run the commands in turn and print medians of their wall time."""
    show = [python, "-m", "gem_core", "show", str(path)]
    index = path.with_name(path.name + ".index")
    cases = {
        "first line, no index": (show, True),
        "first episode, no index": ([*show, "1"], True),
        "last episode, no index": ([*show, str(count)], True),
        "whole list, no index": (show, True),
        "first line, with index": (show, False),
        "last episode, with index": ([*show, str(count)], False),
        "whole list, with index": (show, False),
        "sorted, 20 best, with index": ([*show, "--sort", "return", "--limit", "20"], False),
        "all errors, with index": ([*show, "--errors"], False),
    }
    size = "no index"
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, (command, anew) in cases.items():
            if anew:
                index.unlink(missing_ok=True)
            run = until_first_line if name.startswith("first line") else until_the_end
            seconds[name].append(run(command))
            if index.exists():
                size = f"{index.stat().st_size / 1e6:.1f} MB of index"
    rows = [[name, f"{statistics.median(values) * 1e3:,.0f}"] for name, values in seconds.items()]
    harness.print_table(f"gem show, medians of {repeats} runs, {size}", ["what", "ms"], rows)


def until_first_line(command: list[str]) -> float:
    """Return the seconds until the first line is written; the rest is not waited for."""
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    if process.stdout is not None:
        process.stdout.readline()
    elapsed = time.perf_counter() - started
    if process.stdout is not None:
        process.stdout.close()
    process.wait()
    return elapsed


def until_the_end(command: list[str]) -> float:
    """Return the seconds of a whole run."""
    started = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
