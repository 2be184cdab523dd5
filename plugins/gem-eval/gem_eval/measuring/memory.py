"""Memory that one more environment costs, measured in a process of its own.

``python -m gem_eval.measuring.memory`` reads what to make as JSON from standard input, and writes what it measured.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import gem_core as gem
from gem_core.errors import GemError, NotSupportedError

_ENOUGH_BYTES = 16 << 20
"""Growth at which the pages of the system and the spare room of the allocator no longer matter."""
_MOST = 4096
_FEWEST = 4
_SECONDS = 3.0
_DEADLINE_S = 180.0


class Memory(NamedTuple):
    """What further environments cost.

    Args:
        bytes_each: Growth of the resident memory of the process for each of them, in bytes.
        environments: Number of those by which it grew.
    """

    bytes_each: float
    environments: int


def measure_memory(
    env_id: str, kwargs: Mapping[str, Any], wrappers: Sequence[Any], *, limit_s: float = _SECONDS
) -> Memory:
    """Measure the memory of one more environment, after the first has loaded what all share.

    Each is reset, and takes one random action where it can sample one. What runs in other processes or containers is
    not counted.

    Args:
        env_id: The environment.
        kwargs: Its keyword arguments.
        wrappers: Put around it.
        limit_s: Seconds after which no further one is made.

    Raises:
        GemError: The arguments are no plain JSON, or the process that measures failed; the message ends with what it
            said last.
    """
    try:
        asked = json.dumps({"id": env_id, "kwargs": dict(kwargs), "wrappers": list(wrappers), "limit_s": limit_s})
    except (TypeError, ValueError) as error:
        raise GemError(f"its arguments are no plain JSON, which another process could be given: {error}") from None
    command = [sys.executable, "-m", __name__]
    try:
        done = subprocess.run(command, input=asked, capture_output=True, text=True, timeout=_DEADLINE_S, check=False)
    except subprocess.TimeoutExpired:
        raise GemError(f"measuring memory took more than {_DEADLINE_S:g} s") from None
    lines = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    if done.returncode != 0:
        raise GemError(f"measuring memory failed: {lines[-1] if lines else f'exit code {done.returncode}'}")
    return Memory(**json.loads(lines[-1]))


def growth(
    make: Callable[[], object],
    resident: Callable[[], int],
    limit_s: float,
    clock: Callable[[], float] = time.monotonic,
) -> Memory:
    """Make things until they take enough memory to be measured, and return what each took.

    Args:
        make: Makes one, which is kept.
        resident: Returns the memory of the process in bytes.
        limit_s: Seconds after which no more are made, once there are a few.
        clock: Returns the time in seconds.
    """
    kept = [make()]
    gc.collect()
    before, started = resident(), clock()
    while len(kept) <= _MOST:
        kept.append(make())
        count = len(kept) - 1
        if count >= _FEWEST and (resident() - before > _ENOUGH_BYTES or clock() - started > limit_s):
            break
    gc.collect()
    return Memory(max(resident() - before, 0) / (len(kept) - 1), len(kept) - 1)


def resident_bytes() -> int:
    """Return the resident memory of this process; where the system does not tell, the most that it ever was."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else most * 1024


def _main() -> None:
    asked = json.load(sys.stdin)
    made: list[Any] = []

    def make() -> object:
        env = gem.make(asked["id"], wrappers=asked["wrappers"], **asked["kwargs"])
        made.append(env)
        env.reset(seed=len(made))
        with suppress(NotSupportedError):
            env.step(env.get_wrapper_attr("sample_random_action")())
        return env

    try:
        measured = growth(make, resident_bytes, asked["limit_s"])
    finally:
        for env in made:
            env.close()  # it may have started a container
    sys.stdout.write(json.dumps(measured._asdict()) + "\n")


if __name__ == "__main__":
    try:
        _main()
    except Exception as error:  # noqa: BLE001 - told to the process that asked, whatever it is
        sys.exit(f"{type(error).__name__}: {error}")
