"""For all benchmarks: measure the same work in our environment and in the peer's, side by side.

A benchmark names its *cases*: a command each. ``measure`` runs them in turn, A B C A B C …, so that a change in the
machine's speed meets all of them, and takes medians. Two kinds of figures come out of a run of a command: the wall time
of the whole process, and whatever the command prints as JSON, a mapping of names to numbers, on its last line::

    sides = harness.arguments()
    results = harness.measure({
        "gem_core": harness.snippet(sides.ours, OUR_STEPS),
        "gem-llm": harness.snippet(sides.peer, PEER_STEPS),
    })
    ratio = results["gem-llm"].median("steps_s") / results["gem_core"].median("steps_s")
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

WALL = "wall_s"


@dataclass(frozen=True)
class Sides:
    """The two interpreters, ours and the peer's, and how often each case runs."""

    ours: str
    peer: str
    repeats: int


@dataclass
class Case:
    """All figures of one case, by name, one for each run."""

    figures: dict[str, list[float]] = field(default_factory=dict)

    def median(self, name: str = WALL) -> float:
        """Return the median of a figure over the runs."""
        return statistics.median(self.figures[name])


def arguments() -> Sides:
    """Read the command line that ``make bench`` gives every benchmark."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core")
    parser.add_argument("--peer", required=True, help="interpreter that has gem-llm")
    parser.add_argument("--repeats", type=int, default=21, help="runs of each case, after two to warm up")
    options = parser.parse_args()
    return Sides(options.ours, options.peer, options.repeats)


def snippet(python: str, code: str) -> list[str]:
    """Return the command that runs a piece of code; ``-P`` keeps the current folder out of ``sys.path``."""
    return [python, "-P", "-c", code]


def measure(cases: Mapping[str, Sequence[str]], *, repeats: int = 21, warm_up: int = 2) -> dict[str, Case]:
    """Run all cases in turn and return their figures.

    Args:
        cases: Command of each case, by name.
        repeats: Runs that count, of each case.
        warm_up: Runs before these, which fill caches and compile bytecode.
    """
    results = {name: Case() for name in cases}
    for round_number in range(warm_up + repeats):
        for name, command in cases.items():
            figures = run_once(command)
            if round_number >= warm_up:
                for figure, value in figures.items():
                    results[name].figures.setdefault(figure, []).append(value)
    return results


def run_once(command: Sequence[str]) -> dict[str, float]:
    """Run a command and return its wall time, and the figures on the last line that it printed."""
    started = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    figures = {WALL: time.perf_counter() - started}
    if done.returncode:
        sys.exit(f"error: {' '.join(command)!r} failed:\n{done.stderr}")
    last = done.stdout.strip().rpartition("\n")[2]
    if last.startswith("{"):
        figures |= json.loads(last)
    return figures


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table: the first column to the left, the others to the right."""
    lines = [header, *rows]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    print(f"\n{title}  (Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores)")
    for line in lines:
        cells = (text.rjust(width) for text, width in zip(line[1:], widths[1:], strict=True))
        print(f"  {line[0]:<{widths[0]}}  {'  '.join(cells)}")


def verdict(value: float, budget: float, *, at_least: bool = False) -> str:
    """Say whether a figure is within its budget, which is the most that it may be, or the least."""
    return "met" if (value >= budget if at_least else value < budget) else "MISSED"
