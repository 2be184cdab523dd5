"""What the tests of the Python tool share: pools of each level, and what a sandbox has left behind."""

from __future__ import annotations

import dataclasses
import functools
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gem_core.errors import MissingRequirementError
from gem_tools.python import Limits, Outcome, Pool, levels
from gem_tools.python.inside import usage

ALL = levels.LEVELS
"""Each is tried where it can be had; ``scripts/docker_engine.sh`` starts a container engine."""


@functools.cache
def image() -> str | None:
    """Return the image for the level ``docker``: what ``scripts/docker_engine.sh`` makes, or the usual one."""
    if shutil.which("docker") is not None:
        for name in ("gem-python:base", levels.DOCKER_IMAGE):
            if not docker("image", "inspect", name).returncode:
                return name
    return None


def docker(*words: str) -> subprocess.CompletedProcess[str]:
    """Tell Docker's client something."""
    return subprocess.run(["docker", *words], capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL)


@functools.cache
def why_not(level: str) -> str | None:
    """Return why a level cannot be had on this machine; None where it can."""
    pool = new_pool(level)
    try:
        pool.start()
    except MissingRequirementError as error:
        return str(error)
    finally:
        pool.close()
    return None


def pool_of(level: str, workers: int = 1) -> Pool:
    """Return a pool of a level, or skip the test where it cannot be had."""
    reason = why_not(level)
    if reason is not None:
        pytest.skip(reason)
    pool = new_pool(level, workers)
    pool.start()
    return pool


def new_pool(level: str, workers: int = 1) -> Pool:
    """Return a pool of a level, not yet started."""
    return Pool(level, num_workers=workers, image=image() if level == "docker" else None)


def processes(pool: Pool) -> list[int]:
    """Return all processes of a pool's sandboxes, as this machine sees them; a container's without the client's."""
    if pool.level == "docker":
        lists = [docker("top", cell.launch.container or "", "-eo", "pid").stdout.split()[1:] for cell in pool.cells]
        return [int(pid) for pids in lists for pid in pids]
    proc = os.open("/proc", os.O_RDONLY | os.O_DIRECTORY)
    try:
        found = []
        for cell in pool.cells:
            if cell.process is not None:
                found += usage.tree(proc, [cell.process.pid])
        return found
    finally:
        os.close(proc)


def folders(pool: Pool) -> list[str]:
    """Return the folders on disk of a pool's calls, where it has any."""
    if pool.level == "docker":
        inside = [cell.launch.container or "" for cell in pool.cells]
        lists = [docker("exec", name, "find", "/tmp", "-mindepth", "2", "-maxdepth", "2") for name in inside]
        return [name for done in lists for name in done.stdout.split()]
    return [name for cell in pool.cells for base in [cell.launch.settings["base"]] if base for name in os.listdir(base)]


def memory_mb(pids: list[int]) -> float:
    """Return the anonymous memory of some processes."""
    total = 0
    for pid in pids:
        try:
            lines = Path(f"/proc/{pid}/status").read_text("utf-8").splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith(("RssAnon", "RssShmem")))
    return total / 1024


def until(condition: Callable[[], bool], limit_s: float = 30.0) -> bool:
    """Look until something holds; False when it never does."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


class Watched:
    """A pool, with what belongs to it before anything was tried.

    Args:
        pool: With one worker.
    """

    def __init__(self, pool: Pool) -> None:
        self.pool = pool
        pool.run("")
        until(lambda: len(processes(pool)) == self.usual())
        self.count = len(processes(pool))

    def usual(self) -> int:
        """Return how many processes a sandbox has that waits: its own, the next call's, and bubblewrap's two."""
        return 4 if self.pool.level == "bubblewrap" else 2

    def check(self) -> None:
        """See that the pool still serves, and that nothing is left of earlier calls."""
        pool = self.pool
        outcome = pool.run("import os\nprint(sorted(os.listdir()), os.environ.get('LEFT'))\n6 * 7", value=True)
        assert (outcome.status, outcome.stdout, outcome.value) == ("ok", "[] None\n", "42")
        assert until(lambda: len(processes(pool)) == self.count), [
            Path(f"/proc/{pid}/status").read_text("utf-8").splitlines()[:3] for pid in processes(pool)
        ]
        assert until(lambda: len(folders(pool)) <= 1, 5.0), folders(pool)
        assert memory_mb(processes(pool)) < 150


SMALL = Limits(wall_s=60, memory_mb=128, processes=16, folder_mb=16, file_mb=8, output_bytes=2000)
SHORT = dataclasses.replace(SMALL, wall_s=2)
"""For what ends at its limit of time; all else has so much time that a busy machine does not matter."""


def attack(watched: Watched, code: str, limits: Limits = SMALL, **options: str) -> Outcome:
    """Try an attack, and see that it is over afterwards: the pool still serves, and nothing is left."""
    outcome = watched.pool.run(code, limits=limits, **options)
    watched.check()
    return outcome


TRY = """
import ctypes, fcntl, os, platform, resource, signal, socket
libc, buffer = ctypes.CDLL(None, use_errno=True), ctypes.create_string_buffer(4096)
x86 = platform.machine() == "x86_64"
def call(result):
    if result == -1: raise OSError
def kill(pid, number):
    if pid < 2 or pid == os.getpid(): raise OSError
    os.kill(pid, number)
for line in {lines!r}:
    try: exec(line)
    except (OSError, ValueError): pass
    else: print(line)
"""


def gained(watched: Watched, *lines: str) -> list[str]:
    """Try each line by itself, as one attack; return those that did not fail."""
    outcome = attack(watched, TRY.format(lines=lines))
    assert outcome.status == "ok", outcome
    return outcome.stdout.splitlines()


def each_level(*levels: str) -> Callable[..., Iterator[Watched]]:
    """Return a fixture with a watched pool of each level."""

    @pytest.fixture(scope="module", params=levels or ALL)
    def watched(request: pytest.FixtureRequest) -> Iterator[Watched]:
        pool = pool_of(request.param)
        yield Watched(pool)
        pool.close()

    return watched
