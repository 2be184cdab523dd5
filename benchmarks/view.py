"""After a change of `gem view`: how soon it shows a large run: page, filter, sort, scroll, episode, search, memory.

The run is written to a temporary folder and deleted: ``python benchmarks/view.py --episodes 100000 --megabytes 2000``.
"""

from __future__ import annotations

import argparse
import http.client
import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

import harness

REQUESTS = {
    "rows as they were written": "/api/rows?count=100",
    "rows far down": "/api/rows?count=100&start={far}",
    "filter: failures": "/api/rows?count=100&outcome=failure",
    "filter: a text in ids and rows": "/api/rows?count=100&text=Maze/99",
    "filter: return and turns": f"/api/rows?count=100&return={quote('>0.5')}&turns={quote('<5')}",
    "sort by return": "/api/rows?count=100&sort=return",
    "sort by time, the last first": "/api/rows?count=100&sort=seconds&reverse=1",
    "the next piece of a sorted table": "/api/rows?count=100&sort=seconds&reverse=1&start={far}",
    "an episode": "/api/episode?run=run&number={far}",
}


def main() -> None:
    """Write a run, serve it, and print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_eval")
    parser.add_argument("--peer", help="not used: the peer has no such command")
    parser.add_argument("--episodes", type=int, default=20_000, help="episodes of the run")
    parser.add_argument("--megabytes", type=int, default=100, help="size of its compressed episodes, at least")
    parser.add_argument("--keep", type=Path, help="write the run here and keep it, or take the one that is here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = options.keep or Path(folder, "run")
        if not path.exists():
            generate(path, options.episodes, options.megabytes * 1_000_000)
        size = (path / "episodes.jsonl.zst").stat().st_size
        print(f"\n{size / 1e6:,.0f} MB of episodes, {(path / 'index.jsonl').stat().st_size / 1e6:,.0f} MB of index")
        measure(options.ours, path)


def generate(path: Path, count: int, size: int) -> None:
    """Write episodes of some turns, whose text does not compress well."""
    from gem_core import Episode, Response, Transition
    from gem_eval.records import RunWriter

    chance = random.Random(1)
    characters = size // count
    with RunWriter(path) as writer:
        writer.write_info({"status": "finished", "episodes": count})
        for number in range(count):
            turns = chance.randint(1, 9)
            # zstd leaves half a byte of a hexadecimal digit.
            solved = chance.random() < 0.5
            transitions = [
                Transition(f"Turn {turn}.", Response(said), turn / 10, turn == turns - 1, False, {"correct": solved})
                for turn in range(turns)
                if (said := chance.randbytes(characters // turns + 1).hex())
            ]
            episode = Episode("bench:Maze", number, "Turn 0.", {}, transitions, "The end.", key=str(number))
            row = {"model": f"model-{number % 3}", "row": f"bench:Maze/{number // 3}", "seconds": chance.random() * 60}
            writer.write(episode, {**row, "cost": chance.random()})


def measure(python: str, path: Path) -> None:
    """Serve a run, and print what takes how long."""
    started = time.perf_counter()
    process = subprocess.Popen([python, "-m", "gem_core", "view", str(path)], stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline() if process.stdout is not None else ""
        port = int(line.split("/")[2].split(":")[1])
        get(port, "/")
        page = time.perf_counter() - started
        get(port, "/api/rows?count=100")
        first = time.perf_counter() - started
        while b'"reading": 1.0' not in get(port, "/api/runs"):
            time.sleep(0.05)
        read = time.perf_counter() - started
        while b'"metric"' not in get(port, "/api/runs"):
            time.sleep(0.05)
        scored = time.perf_counter() - started
        rows = [
            ["page", f"{page * 1e3:,.0f}"],
            ["first rows", f"{first * 1e3:,.0f}"],
            ["all rows read", f"{read * 1e3:,.0f}"],
            ["scores with intervals", f"{scored * 1e3:,.0f}"],
        ]
        far = 2 * int(get(port, "/api/rows?count=1").split(b'"total": ')[1].split(b",")[0]) // 3
        for name, address in REQUESTS.items():
            rows.append([name, f"{timed(port, address.format(far=far)) * 1e3:,.0f}"])
        started = time.perf_counter()
        get(port, "/api/search?wanted=nowhere+to+be+found")
        rows.append(["search of all transcripts", f"{(time.perf_counter() - started) * 1e3:,.0f}"])
        harness.print_table("gem view, milliseconds", ["what", "ms"], rows)
        status = Path(f"/proc/{process.pid}/status")
        if status.exists():
            memory = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
            print(f"most memory: {int(memory.split()[1]) / 1e3:,.0f} MB")
    finally:
        process.terminate()
        process.wait()


def timed(port: int, address: str) -> float:
    """Return the seconds of a request, the median of three that are not answered from memory."""
    seconds = []
    for attempt in range(3):
        # Another query in between, so that filters and orders are computed anew.
        for other in range(8):
            get(port, f"/api/rows?count=1&text=other{attempt}{other}")
        if "start" in address:
            get(port, address.split("&start")[0])
        started = time.perf_counter()
        get(port, address)
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds)


def get(port: int, address: str) -> bytes:
    """Return the answer to a request."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", address)
    content = connection.getresponse().read()
    connection.close()
    return content


if __name__ == "__main__":
    main()
