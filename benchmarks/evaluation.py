"""After a change of `gem eval` or gem-openai: what a run costs beside inspect_ai and the bare `openai` package.

A server answers at once. A game of six turns, 500 times, 64 at once: a guess that is well-formed and never right
answers each turn. The peers send the same six messages of the user, and nothing is graded there. The server runs in a
process of its own, and notes when the first completion is asked for. Figures of a case are those of its whole process,
from the command to its end: imports, the game, the requests, the record.

inspect_ai and openai live in an environment beside ours, `.venv-inspect`; where it is not there, they are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import harness

EPISODES, TURNS, AT_ONCE, MANY_AT_ONCE = 500, 6, 64, 256
BUDGET_CPU_S, BUDGET_FIRST_S, BUDGET_RSS_MB, BUDGET_RECORDING, BUDGET_BYTES = 1.3, 1.0, 100, 0.1, 1 / 3
GAME = ["game:Mastermind-v0-hard", "--set", f"max_turns={TURNS}"]

SERVER = r"""
import asyncio, json, random, time

WORDS = "the first second last number place right wrong so black white pegs say that then maybe keep move try".split()
draw = random.Random(1)
THOUGHTS = [" ".join(draw.choices(WORDS, k=45)) for _ in range(997)]
calls, first = 0, 0.0

def completion(body):
    global calls, first
    first, calls = first or time.time(), calls + 1
    guess = body.count(b'"assistant"') + 1
    text = f"{THOUGHTS[calls % 997]}. \\boxed{{{guess} {guess} {guess + 1} {guess + 2}}}"  # no code has a number twice
    usage = {"prompt_tokens": len(body) // 4, "completion_tokens": 60, "total_tokens": len(body) // 4 + 60}
    choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": text}}
    return {"id": f"c{calls}", "object": "chat.completion", "created": 1, "model": "m", "choices": [choice],
        "usage": usage}

async def serve(reader, writer):
    global calls, first
    try:
        while True:
            head = await reader.readuntil(b"\r\n\r\n")
            if head.startswith(b"POST"):
                fields = (line.lower().partition(b":") for line in head.split(b"\r\n"))
                (length,) = [int(value) for name, _, value in fields if name == b"content-length"]
                answer = completion(await reader.readexactly(length))
            elif b"/figures" in head:
                answer = {"calls": calls, "first": first}
                calls, first = 0, 0.0
            else:
                answer = {"data": [{"id": "m"}]}
            body = json.dumps(answer).encode()
            writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n")
            writer.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
            await writer.drain()
    except (asyncio.IncompleteReadError, ConnectionError):
        writer.close()

async def main():
    server = await asyncio.start_server(serve, "127.0.0.1", 0, backlog=1024)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()

asyncio.run(main())
"""

NOT_WRITTEN = """
from gem_core.cli import main
from gem_eval.records import Row, Run, RunWriter

rows = []

def write(self, episode, told):
    rows.append(Row.of_episode(episode, told, len(rows) + 1, 0, 0))
    return rows[-1]

RunWriter.write, Run.rows = write, rows  # scored and shown as ever
main()
"""

INSPECT = """
from inspect_ai import Task, task
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessageUser
from inspect_ai.scorer import includes
from inspect_ai.solver import solver

@solver
def play():
    async def solve(state, generate):
        for text in TEXTS[1:]:
            state = await generate(state)
            state.messages.append(ChatMessageUser(content=text))
        return await generate(state)
    return solve

@task
def six_turns():
    return Task([Sample(input=TEXTS[0], target="won") for _ in range(EPISODES)], solver=play(), scorer=includes())
"""

OPENAI = """
import asyncio
from openai import AsyncOpenAI

async def main():
    gate, client = asyncio.Semaphore(AT_ONCE), AsyncOpenAI()
    async def play():
        async with gate:
            messages = []
            for text in TEXTS:
                messages.append({"role": "user", "content": text})
                answer = await client.chat.completions.create(model="m", messages=messages)
                messages.append({"role": "assistant", "content": answer.choices[0].message.content})
    await asyncio.gather(*(play() for _ in range(EPISODES)))

asyncio.run(main())
"""


class Bench:
    """The commands of all sides, and the server that they ask.

    Args:
        ours: Interpreter that has gem_core and gem_eval.
        inspect: Interpreter that has inspect_ai and openai; None where there is none.
        folder: Where records go.
        url: Address of the server.
    """

    def __init__(self, ours: str, inspect: str | None, folder: Path, url: str) -> None:
        self.ours, self.inspect, self.folder, self.url = ours, inspect, folder, url
        self.record_of_run, self.records = folder / "run.jsonl", 0
        self.env = {**os.environ, "OPENAI_BASE_URL": url, "OPENAI_API_KEY": "none"}

    def record_by_gem_run(self) -> None:
        """Play the episodes by ``gem run``: its record is compared with ours, and the peers send its texts."""
        options = ["--agent", "openai:m", "--episodes", str(EPISODES), "--max-concurrency", str(AT_ONCE)]
        self.figures_of([self.ours, "-m", "gem_core", "run", *GAME, *options, "--out", str(self.record_of_run)])

    def commands(self, at_once: int, *, peers: bool = True) -> dict[str, list[str]]:
        """Return the commands of all sides, or of ours, by name, each with a record of its own."""
        self.records += 1
        wanted = ["eval", *GAME, "--model", "openai:m", "-n", str(EPISODES), "--max-concurrency", str(at_once)]
        found = {
            "gem eval": [self.ours, "-m", "gem_core", *wanted, "--out", str(self.record("eval"))],
            "not written": [*harness.snippet(self.ours, NOT_WRITTEN), *wanted, "--out", str(self.record("unwritten"))],
        }
        if peers and self.inspect is not None:
            given = f"TEXTS, EPISODES, AT_ONCE = {self.texts()!r}, {EPISODES}, {at_once}\n"
            task = self.folder / "six_turns.py"
            task.write_text(given + INSPECT)
            options = ["--model", "openai/m", "-M", "responses_api=false", "--display", "none"]
            options += ["--max-connections", str(at_once), "--max-samples", str(at_once)]
            found["inspect_ai"] = [self.inspect, "-m", "inspect_ai", "eval", task.name, *options]
            found["inspect_ai"] += ["--log-dir", str(self.record("inspect"))]
            found["openai"] = harness.snippet(self.inspect, given + OPENAI)
        return found

    def record(self, side: str) -> Path:
        """Return the folder of a side's latest record."""
        return self.folder / f"{side}-{self.records}"

    def texts(self) -> list[str]:
        """Return what the user says in the turns of an episode."""
        from gem_core import read_episodes

        messages = next(iter(read_episodes(self.record_of_run))).messages
        return [message["content"] for message in messages if message["role"] == "user"][:TURNS]

    def figures_of(self, command: Sequence[str]) -> dict[str, float]:
        """Run a command and return its figures."""
        self._counted()
        with (self.folder / "output").open("w+") as output:
            began, started = time.time(), time.perf_counter()
            process = subprocess.Popen(command, cwd=self.folder, env=self.env, stdout=output, stderr=output)
            _, status, used = os.wait4(process.pid, 0)
            wall = time.perf_counter() - started
            process.returncode = os.waitstatus_to_exitcode(status)
            counted = self._counted()
            if process.returncode or counted["calls"] != EPISODES * TURNS:
                output.seek(0)
                sys.exit(f"error: {command} ended with {process.returncode} after {counted}:\n{output.read()}")
        return {
            harness.WALL: wall,
            "cpu_s": (used.ru_utime + used.ru_stime) / counted["calls"] * 1000,
            "first_s": counted["first"] - began,
            "rss_mb": used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e6 / 1024),
        }

    def _counted(self) -> dict[str, float]:
        """Return what the server has counted since it was asked last."""
        with urllib.request.urlopen(f"{self.url}/figures") as answer:
            counted: dict[str, float] = json.load(answer)
        return counted


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_eval")
    parser.add_argument("--peer", help="not used here; 'make bench' names it to every benchmark")
    parser.add_argument("--inspect", help="interpreter that has inspect_ai; by default in .venv-inspect beside ours")
    parser.add_argument(
        "--repeats", type=int, default=5, help="runs of our cases; the peers take a minute, and run once"
    )
    options = parser.parse_args()
    ours = Path(options.ours).absolute()
    home = ours.parent.parent
    inspect = Path(options.inspect or home.with_name(f"{home.name}-inspect") / "bin" / "python").absolute()
    if not inspect.exists():
        print(f"\ninspect_ai and openai left out: there is no {inspect}; 'make bench' makes it")
    with ExitStack() as at_end:
        folder = Path(at_end.enter_context(tempfile.TemporaryDirectory()))
        server = subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True)
        at_end.callback(server.wait)
        at_end.callback(server.kill)
        port = int(server.stdout.readline()) if server.stdout is not None else 0
        url = f"http://127.0.0.1:{port}/v1"
        measure(Bench(str(ours), str(inspect) if inspect.exists() else None, folder, url), options.repeats)


def measure(bench: Bench, repeats: int) -> None:
    """Run all sides in turn and print the tables."""
    bench.record_by_gem_run()
    cases: dict[str, harness.Case] = {}
    for round_number in range(repeats):
        for name, command in bench.commands(AT_ONCE, peers=round_number == 0).items():
            case = cases.setdefault(name, harness.Case())
            for figure, value in bench.figures_of(command).items():
                case.figures.setdefault(figure, []).append(value)
    sizes = {"gem eval": bytes_of(bench.record("eval"))}
    memory = {name: bench.figures_of(command)["rss_mb"] for name, command in bench.commands(MANY_AT_ONCE).items()}
    sizes["inspect_ai"] = bytes_of(bench.record("inspect"))
    print_sides(cases, memory, sizes, repeats)
    print_budgets(cases, memory["gem eval"], sizes["gem eval"] / bytes_of(bench.record_of_run))


def print_sides(
    cases: Mapping[str, harness.Case], memory: Mapping[str, float], sizes: Mapping[str, float], repeats: int
) -> None:
    """Print the figures of all sides."""
    title = (
        f"{EPISODES} episodes of {TURNS} turns, {AT_ONCE} at once, a scripted server; ours: medians of {repeats} runs"
    )
    header = ["", "wall s", "processor s / 1,000 calls", "first request s", f"MB, {MANY_AT_ONCE} at once"]
    rows = [
        [
            name,
            f"{case.median():.1f}",
            f"{case.median('cpu_s'):.2f}",
            f"{case.median('first_s'):.2f}",
            f"{memory[name]:.0f}",
            f"{sizes[name]:,.0f}" if sizes.get(name) else "-",
        ]
        for name, case in cases.items()
    ]
    harness.print_table(title, [*header, "bytes / episode"], rows)


def print_budgets(cases: Mapping[str, harness.Case], memory: float, share: float) -> None:
    """Print what `gem eval` is held to."""
    ours = cases["gem eval"]
    recording = ours.median("cpu_s") / cases["not written"].median("cpu_s") - 1
    rows: list[tuple[str, float, float]] = [
        ("processor time of 1,000 calls, s", ours.median("cpu_s"), BUDGET_CPU_S),
        ("first request, s", ours.median("first_s"), BUDGET_FIRST_S),
        (f"memory at {MANY_AT_ONCE} at once, MB", memory, BUDGET_RSS_MB),
        ("processor time more for the record", recording, BUDGET_RECORDING),
        ("bytes, of those of gem run", share, BUDGET_BYTES),
    ]
    harness.print_table(
        "gem eval",
        ["figure", "measured", "budget", ""],
        [[name, f"{value:.2f}", f"{budget:.2f}", harness.verdict(value, budget)] for name, value, budget in rows],
    )


def bytes_of(record: Path) -> float:
    """Return the bytes of a record for each episode: of a file, or of all files in a folder."""
    files = [record] if record.is_file() else [path for path in record.rglob("*") if path.is_file()]
    return sum(path.stat().st_size for path in files) / EPISODES


if __name__ == "__main__":
    main()
