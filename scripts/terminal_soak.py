"""For `make test-thorough` and changes of gem-terminal: play while processes are killed, and look what is left.

Workers play ``terminal:Sample`` with an agent that leaves things running and kills its own shell. Meanwhile a worker is
killed with SIGKILL or interrupted as by Ctrl-C, or a container of ours is killed, at times that a seed chooses. In the
end all workers are killed, what they left is swept as by the next process, and nothing may be there::

    GEM_TERMINAL_BASE_IMAGE=gem-python:base python scripts/terminal_soak.py --episodes 200

The exit code is 0 when as many episodes were finished as asked for and nothing is left. Things of other processes on
the same engine are told apart by the label that ``GEM_TERMINAL_RUN`` gives ours.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import queue
import random
import secrets
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from gem_terminal.backends.docker.engine import Engine
from gem_terminal.backends.docker.sweeping import sweep

WORKER = """
import json, random, sys
import gem_core as gem

draw = random.Random(int(sys.argv[1]))
deeds = [
    "<bash>ls -la</bash>", "<bash>echo word > word.txt</bash>", "<bash>sleep 1000 & disown</bash>",
    "<bash>kill -9 $$</bash>", "<bash>(while :; do date > /tmp/now; done) &</bash>", "<bash>exit 3</bash>",
    "<keys>python3<Enter></keys>", "<bash timeout='1'>sleep 30</bash>", "no action at all",
    "<bash timeout='2'>b() { b | b & }; b</bash>", "<bash>ln -s /etc /tests; head -c 1G /dev/zero > /big</bash>",
    "<bash>pkill sleep; kill -9 -1</bash>",
    "<bash>(trap '' TERM HUP; while :; do for p in /proc/[0-9]*; do p=${p#/proc/}; [ $p -gt $BASHPID ] && "
    "kill -9 $p; done; done) &</bash>",
]

def agent(observation, context):
    return "<finish/>" if draw.random() < 0.3 else draw.choice(deeds)

vector = gem.make_vec("terminal:Sample", int(sys.argv[2]), max_turns=6, memory_mb=256, processes=64)
for episode in gem.rollout(vector, agent, episodes=10**6, seed=int(sys.argv[1])):
    info = episode.transitions[-1].info if episode.transitions else episode.info
    print(json.dumps({"error": (info.get("error") or {}).get("message"), "correct": info.get("correct")}), flush=True)
"""


@dataclass
class Soak:
    """One run.

    Args:
        num_envs: Environments of each worker.
        seed: Chooses what is killed, and when.
    """

    num_envs: int
    seed: int
    run: str = field(default_factory=lambda: f"soak-{secrets.token_hex(4)}")
    workers: list[subprocess.Popen[str]] = field(default_factory=list)
    episodes: queue.SimpleQueue[str] = field(default_factory=queue.SimpleQueue)
    done: collections.Counter[str] = field(default_factory=collections.Counter)
    started: int = 0

    def play(self, episodes: int, workers: int, every_s: float) -> None:
        """Play so many episodes, and kill something every few seconds."""
        draw = random.Random(self.seed)
        next_kill = time.monotonic() + every_s
        while self.done["episodes"] < episodes:
            self.workers = [worker for worker in self.workers if worker.poll() is None]
            while len(self.workers) < workers:
                self._start_worker()
            try:
                row = json.loads(self.episodes.get(timeout=max(0.05, next_kill - time.monotonic())))
                self.done["episodes"] += 1
                self.done["errors"] += row["error"] is not None
                self.done["correct"] += bool(row["correct"])
                if self.done["episodes"] % 20 == 0:
                    print(f"{self.run}: {dict(self.done)}", file=sys.stderr, flush=True)
            except queue.Empty:
                pass
            if time.monotonic() >= next_kill:
                self._kill_something(draw)
                next_kill = time.monotonic() + draw.uniform(0.2, 2 * every_s)

    def end(self) -> None:
        """Kill all workers."""
        for worker in self.workers:
            worker.kill()
            worker.wait()

    def containers(self) -> list[str]:
        """Return the containers of this run."""
        return _lines("docker", "ps", "--all", "--quiet", "--filter", f"label=gem-terminal.run={self.run}")

    def left(self) -> dict[str, list[str]]:
        """Return all that is there of this run: containers, networks, volumes, processes."""
        found = {"containers": self.containers(), "processes": self._processes()}
        mine = f"label=gem-terminal.run={self.run}"
        for what in ("network", "volume"):
            found[f"{what}s"] = _lines("docker", what, "ls", "--quiet", "--filter", mine)
        return found

    def _processes(self) -> list[str]:
        mark = f"GEM_TERMINAL_RUN={self.run}".encode()
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if int(folder.name) != os.getpid() and mark in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(folder.name + " " + (folder / "cmdline").read_text().replace("\0", " ")[:80])
            except OSError:
                continue
        return found

    def _start_worker(self) -> None:
        self.started += 1
        words = [sys.executable, "-c", WORKER, str(self.seed * 1000 + self.started), str(self.num_envs)]
        environment = {**os.environ, "GEM_TERMINAL_RUN": self.run}
        worker = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment)
        self.workers.append(worker)
        threading.Thread(target=self._read, args=(worker,), daemon=True).start()

    def _read(self, worker: subprocess.Popen[str]) -> None:
        for line in worker.stdout or ():
            self.episodes.put(line)

    def _kill_something(self, draw: random.Random) -> None:
        containers = self.containers()
        if containers and draw.random() < 0.6:
            subprocess.run(["docker", "kill", draw.choice(containers)], capture_output=True, check=False, timeout=60)
            self.done["containers killed"] += 1
        elif draw.random() < 0.8:
            draw.choice(self.workers).kill()
            self.done["workers killed"] += 1
        else:
            draw.choice(self.workers).send_signal(signal.SIGINT)
            self.done["workers interrupted"] += 1


def _lines(*words: str) -> list[str]:
    return subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout.split()


def main() -> None:
    """Run, and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--num-envs", type=int, default=4, help="environments of each worker")
    parser.add_argument("--every", type=float, default=3.0, help="seconds between two kills, on average")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    soak = Soak(options.num_envs, options.seed)
    began = time.monotonic()
    try:
        soak.play(options.episodes, options.workers, options.every)
        soak.done["things at the end"] = sum(map(len, soak.left().values()))
    finally:
        soak.end()
    swept = sweep(Engine())
    # Processes in containers end a moment after their worker.
    until = time.monotonic() + 30
    while any(soak.left().values()) and time.monotonic() < until:
        time.sleep(0.5)
    left = soak.left()
    print(f"{dict(soak.done)}, {soak.started} workers, {len(swept)} swept, {time.monotonic() - began:.0f} s")
    print(f"left: {left}")
    sys.exit(1 if any(left.values()) else 0)


if __name__ == "__main__":
    main()
