"""After a change of imports: how long `import gem_core` takes, beside the peer's `import gem`, and `gem list`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import harness

IMPORT_BUDGET_S = 0.1
LIST_BUDGET_S = 0.3
COUNT = "import json, sys; n = len(sys.modules); import {}; print(json.dumps({{'modules': len(sys.modules) - n}}))"


def main() -> None:
    """Measure and print both tables."""
    sides = harness.arguments()
    measure_imports(sides)
    measure_list(sides)


def measure_imports(sides: harness.Sides) -> None:
    """Compare the wall time of whole processes that only import."""
    results = harness.measure(
        {
            "bare": harness.snippet(sides.ours, "pass"),
            "gem_core": harness.snippet(sides.ours, "import gem_core"),
            "bare, peer's environment": harness.snippet(sides.peer, "pass"),
            "gem (gem-llm)": harness.snippet(sides.peer, "import gem"),
        },
        repeats=sides.repeats,
    )
    wall = {name: case.median() for name, case in results.items()}
    ours = wall["gem_core"] - wall["bare"]
    peer = wall["gem (gem-llm)"] - wall["bare, peer's environment"]
    added = {"gem_core": ours, "gem (gem-llm)": peer}
    modules = {
        "gem_core": harness.run_once(harness.snippet(sides.ours, COUNT.format("gem_core")))["modules"],
        "gem (gem-llm)": harness.run_once(harness.snippet(sides.peer, COUNT.format("gem")))["modules"],
    }
    rows = [
        [
            name,
            f"{seconds * 1e3:.1f}",
            f"{added[name] * 1e3:.1f}" if name in added else "",
            f"{modules[name]:.0f}" if name in modules else "",
        ]
        for name, seconds in wall.items()
    ]
    header = ["import", "process ms", "over bare ms", "modules added"]
    harness.print_table(f"Import time, medians of {sides.repeats} alternating runs", header, rows)
    print(
        f"  budget: gem_core under {IMPORT_BUDGET_S * 1e3:.0f} ms over bare: {harness.verdict(ours, IMPORT_BUDGET_S)}"
    )
    print(f"  ratio: gem-llm adds {peer / ours:.0f} times as much; its whole process takes", end=" ")
    print(f"{wall['gem (gem-llm)'] / wall['gem_core']:.1f} times as long")


def measure_list(sides: harness.Sides) -> None:
    """Time `gem list` with all installed plugins."""
    command = [str(Path(sides.ours).with_name("gem")), "list"]
    try:
        tried = subprocess.run(command, capture_output=True, text=True, check=False)
        reason = tried.stderr.strip().rpartition("\n")[2] if tried.returncode else ""
    except FileNotFoundError:
        reason = "no such command"
    if reason:
        print(f"\n'gem list' skipped: {reason}")
        return
    wall = harness.measure({"gem list": command}, repeats=sides.repeats)["gem list"].median()
    rows = [["gem list", f"{wall * 1e3:.1f}", f"{LIST_BUDGET_S * 1e3:.0f}", harness.verdict(wall, LIST_BUDGET_S)]]
    harness.print_table(f"Command line, median of {sides.repeats} runs", ["command", "ms", "budget ms", ""], rows)


if __name__ == "__main__":
    main()
