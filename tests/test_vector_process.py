"""Worker processes of vector environments: what they are started from, what they move, and how they end."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import vector_envs
from vector_envs import IMAGES, INLINE, THREAD, eventually, is_alive

import gem_core as gem
from gem_core.vector import NoRoomError, VectorEnv, VectorSetup, Worker, WorkerLoop, WorkerPool

TESTS = str(Path(__file__).parent)

LONGEST_S = 60.0
"""Ends a hang; nothing here takes so long."""


def workers() -> list[int]:
    return vector_envs.workers_of(os.getpid())


def kill_worker(pid: int) -> None:
    """Kill a worker, and return when it has ended."""
    os.kill(pid, signal.SIGKILL)
    os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)


@pytest.fixture(autouse=True)
def no_workers_of_others() -> None:
    """What other tests left to the garbage collector has ended."""
    assert eventually(lambda: not workers())


class HereWorker(Worker):
    """A worker in this process."""

    def __init__(self, packed: bytes) -> None:
        self.loop, self.alive = WorkerLoop(packed), True

    def request(self, data: bytes, timeout_s: float | None) -> bytes:
        return self.loop.handle(data)

    def is_alive(self) -> bool:
        return self.alive

    def kill(self) -> None:
        self.alive = False


def test_slots_without_room_for_a_worker_share_a_living_one() -> None:
    """An episode in the lost worker is collateral; without any worker, the run ends."""
    found: list[HereWorker] = []

    def start(packed: bytes) -> HereWorker:
        if len(found) == 2:
            raise NoRoomError("the cluster is full")
        found.append(HereWorker(packed))
        return found[-1]

    setup = VectorSetup.of(INLINE, 4, seed=3)
    vector = VectorEnv(setup, pool=WorkerPool(setup, start, 2))
    vector.reset()
    found[0].alive = False
    errors = [info.get("final_info", {}).get("error") for info in vector.step(["a"] * 4).infos]
    assert sorted(error["kind"] for error in errors if error) == ["collateral"] * 2
    assert not any("final_info" in info for info in vector.step(["a"] * 4).infos)
    found[1].alive = False
    with pytest.raises(NoRoomError):
        vector.step(["a"] * 4)
    vector.close()


def test_a_slot_goes_on_when_its_former_environment_closes_late() -> None:
    """A slot that changes environments closes the former one aside, which may end after the next one has begun."""
    setup = VectorSetup.of(INLINE, 1, seed=3)
    pool = WorkerPool(setup, HereWorker, 1)
    former, present = pool.make(0, INLINE, {}), pool.make(0, INLINE, {})
    former.reset(seed=1)
    present.reset(seed=1)
    former.close()
    assert not present.step("a")[2]
    pool.close()


def test_an_interrupted_request_ends_its_worker() -> None:
    """Its reply would be read as that of the next request."""

    class InterruptedWorker(HereWorker):
        interrupt = False

        def request(self, data: bytes, timeout_s: float | None) -> bytes:
            if self.interrupt:
                raise KeyboardInterrupt
            return super().request(data, timeout_s)

    setup = VectorSetup.of(INLINE, 1, seed=3)
    worker = InterruptedWorker(pickle.dumps(setup))
    vector = VectorEnv(setup, pool=WorkerPool(setup, lambda packed: worker, 1))
    vector.reset()
    worker.interrupt = True
    with pytest.raises(KeyboardInterrupt):
        vector.sample_random_action(0)
    assert not worker.alive
    vector.close()


# Death from outside.


def test_worker_killed_while_idle_ends_its_episodes_as_collateral() -> None:
    """Nobody in it is to blame; those in another worker, and the next episodes, go on."""
    vector = gem.make_vec(INLINE, 4, backend=("process", {"workers": 2}), seed=3, length=5)
    vector.reset()
    kill_worker(workers()[0])
    infos = vector.step(["a"] * 4).infos
    kinds = [info.get("final_info", {}).get("error", {}).get("kind") for info in infos]
    assert sorted(kinds, key=str) == [None, None, "collateral", "collateral"]
    assert vector.faults == 0
    assert not vector.step(["b"] * 4).truncated.any()
    vector.close()


def test_a_rollout_begins_after_an_idle_worker_was_killed() -> None:
    """How many tasks there are does not depend on the episode that was lost."""
    vector = gem.make_vec(INLINE, 1, backend="process", seed=3, length=5)
    vector.reset()
    kill_worker(workers()[0])
    assert [episode.error for episode in gem.rollout(vector, lambda observation: "a", episodes=1)] == [None]
    vector.close()


def test_worker_killed_in_the_middle_of_a_step_truncates_that_step() -> None:
    """Those that lived beside it end when they are stepped next."""
    vector = gem.make_vec([THREAD, INLINE], 4, backend=("process", {"workers": 1}), seed=3, length=5)
    vector.reset()
    vector.send({0: "!children, hang"})
    (pid,) = workers()
    assert eventually(lambda: vector_envs.children_of(pid))
    os.kill(pid, signal.SIGKILL)
    received = vector.recv()
    assert received.slots == [0]
    assert received.infos[0]["final_info"]["error"] == {
        "kind": "died",
        "message": "its worker process was killed by SIGKILL",
    }
    beside = vector.step({1: "a", 2: "a", 3: "a"}).infos
    assert [info["final_info"]["error"]["kind"] for info in beside] == ["collateral"] * 3
    assert vector.faults == 1
    vector.close()


# What they leave behind.


@pytest.mark.few(1)
@pytest.mark.parametrize("how", ["close", "kill", "drop"])
def test_processes_that_an_environment_left_behind_end_with_its_worker(how: str) -> None:
    """However that ends; one that was killed is noticed by the next step."""
    vector = gem.make_vec(THREAD, 1, backend="process", seed=1, length=3)
    vector.reset()
    vector.step(["!children"])
    (pid,) = workers()
    # A program that has just been started shows no arguments for a moment.
    assert eventually(lambda: len(vector_envs.children_of(pid)) == 1)
    children = vector_envs.children_of(pid)
    if how == "close":
        vector.close()
    elif how == "kill":
        os.kill(pid, signal.SIGKILL)
        vector.step(["a"])
    else:
        del vector
        gc.collect()
    assert eventually(lambda: not is_alive(pid) and not is_alive(children[0]))


# What they move.


def test_large_observations_images_and_actions_arrive_intact() -> None:
    """Twenty megabytes of text, content parts, and a response of megabytes."""
    sizes, padding = [1, 20_000_000, 3], " " * 5_000_000
    results = []
    for backend in ("sync", "process"):
        with gem.make_vec(IMAGES, 3, backend=backend, seed=2) as vector:
            vector.reset()
            results.append(vector.step([padding + str(size) for size in sizes]))
    assert [info["length"] for info in results[1].infos] == [len(padding) + 1, len(padding) + 8, len(padding) + 1]
    for here, there, size in zip(results[0].observations, results[1].observations, sizes, strict=True):
        assert there[0]["text"] == "ä" * size  # type: ignore[index]  # content parts
        assert there[1]["image"].tobytes() == here[1]["image"].tobytes()  # type: ignore[index]  # as above


@pytest.mark.thorough
def test_thousands_of_slots_work() -> None:
    """In processes and without."""
    for backend in ("sync", "async", "process"):
        with gem.make_vec(INLINE, 4096, backend=backend, seed=2, length=3) as vector:
            assert len(vector.reset()[0]) == 4096
            step = vector.step(["a"] * 4096)
            assert sum(info["turn"] for info in step.infos) == 4096
            first = step.observations[4095] if backend == "sync" else first  # noqa: F821 - the first backend sets it
            assert step.observations[4095] == first


# Exit and Ctrl-C: programs of their own.

PRELUDE = f"""
import os, sys, threading
sys.path.insert(0, {TESTS!r})
import vector_envs, gem_core as gem
vector_envs.register_vector_envs()
def begin(env_id, count, backend, **options):
    vector = gem.make_vec(env_id, count, backend=backend, seed=1, length=3, **options)
    vector.reset()
    print(*vector_envs.workers_of(os.getpid()), flush=True)
    return vector
"""


def program(body: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PRELUDE + body],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def first_pids(process: subprocess.Popen[str]) -> list[int]:
    return [int(pid) for pid in process.stdout.readline().split()]  # type: ignore[union-attr]  # it is a pipe


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("ending", "code", "error"),
    [
        ("raise ValueError('on purpose')", 1, "ValueError: on purpose\n"),
        ("vector.send(['!hang'] * 4)", 0, ""),
        ("os.kill(os.getpid(), 15)", -15, ""),
        ("os.kill(os.getpid(), 9)", -9, ""),
    ],
)
def test_program_that_ends_without_closing_leaves_nothing(ending: str, code: int, error: str) -> None:
    """Neither a worker, nor what it started, nor words on standard error."""
    process = program(
        f"vector = begin({THREAD!r}, 4, 'process')\nvector.step(['!children'] * 4)\nprint(1, flush=True)\n{ending}\n"
    )
    workers = first_pids(process)
    process.stdout.readline()  # type: ignore[union-attr]  # it is a pipe
    assert len(workers) >= 1
    _, errors = process.communicate(timeout=LONGEST_S)
    assert process.returncode == code
    assert errors.endswith(error)
    assert bool(errors) == bool(error)
    assert eventually(lambda: not any(is_alive(pid) for pid in workers))
    assert eventually(lambda: not any(vector_envs.children_of(pid) for pid in workers))


WAITS = {
    "recv": "vector.send(['!hang'] * 2); vector.recv()",
    "with": "with vector: vector.step(['!hang'] * 2)",
    "rollout": "list(gem.rollout(vector, lambda observation: '!hang', episodes=4))",
    "rollout of a slow agent": (
        "import asyncio\nasync def agent(observation): await asyncio.Event().wait()\n"
        "list(gem.rollout(vector, agent, episodes=4))"
    ),
    "arollout": (
        "import asyncio\nasync def agent(observation): return '!hang'\nasync def main():\n"
        "    async for episode in gem.arollout(vector, agent, episodes=4): pass\nasyncio.run(main())"
    ),
}


@pytest.mark.parametrize("backend", ["async", "process"])
@pytest.mark.parametrize("how", WAITS)
@pytest.mark.few(2)
def test_interrupt_ends_a_program_that_waits(how: str, backend: str) -> None:
    """With ``KeyboardInterrupt`` and nothing else, and without a worker."""
    env_id = THREAD if backend == "async" else INLINE
    waiting = "threading.Timer(0.2, lambda: print('waiting', flush=True)).start()\n"
    process = program(f"vector = begin({env_id!r}, 2, {backend!r})\n{waiting}{WAITS[how]}\n", start_new_session=True)
    workers = first_pids(process)
    assert process.stdout.readline() == "waiting\n"  # type: ignore[union-attr]  # it is a pipe
    os.kill(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=LONGEST_S)
    assert process.returncode in (-signal.SIGINT, 1), errors
    assert errors.count("Traceback") == 1 + errors.count("During handling") + errors.count("direct cause"), errors
    assert errors.endswith("KeyboardInterrupt\n")
    assert "Exception in thread" not in errors
    assert eventually(lambda: not any(is_alive(pid) for pid in workers))


@pytest.mark.parametrize("backend", ["sync", "process"])
def test_a_child_that_an_environment_forks_ends_by_itself(backend: str) -> None:
    """It does not go on with the program, nor with its worker's."""
    process = program(
        "class ForkingEnv(gem.Env):\n"
        "    def reset(self, seed=None, options=None):\n        super().reset(seed=seed)\n        return 'x', {}\n"
        "    def step(self, action):\n        child = os.fork()\n        if not child:\n            sys.exit(7)\n"
        "        status = os.waitpid(child, 0)[1]\n"
        "        return str(os.waitstatus_to_exitcode(status)), 0.0, False, False, {}\n"
        "gem.register('own:Forking-v0', ForkingEnv)\n"
        f"with gem.make_vec('own:Forking-v0', backend={backend!r}) as vector:\n"
        "    vector.reset()\n    print(vector.step(['a']).observations, flush=True)\n"
    )
    out, errors = process.communicate(timeout=LONGEST_S)
    assert out.splitlines() == ["['7']"], errors


def test_hung_thread_does_not_hold_up_the_exit() -> None:
    """It is abandoned, and ends with the process."""
    process = program(
        f"vector = begin({THREAD!r}, 2, 'async', step_timeout=0.5)\n"
        "print(vector.step(['!hang'] * 2).truncated.tolist(), flush=True)\n"
    )
    out, errors = process.communicate(timeout=LONGEST_S)
    assert (process.returncode, out.strip(), errors) == (0, "[True, True]", "")


SCRIPT = '''
import threading, gem_core as gem

class Local(gem.Env):
    """Defined in the script."""
    def __init__(self, size=3):
        super().__init__()
        self.size = size
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        return f"start {self.size}", {}
    def step(self, action):
        return helper(action), 1.0, False, False, {"by": threading.current_thread().name}

class Computing(Local):
    concurrency = "process"

def helper(action):
    return f"heard {action}"

def louder(env):
    class Loud(gem.Wrapper):
        def after_step(self, action, result):
            return (result[0].upper(), *result[1:])
    return Loud(env)

gem.register("script:Local-v0", Local)
gem.register("script:Lambda-v0", lambda size=5: Local(size))
gem.register("script:Computing-v0", Computing)
for backend in ("sync", "process"):
    with gem.make_vec(["script:Local-v0", "script:Lambda-v0"], 3, backend=backend, wrappers=[louder], seed=1) as vector:
        print(vector.reset()[0], vector.step(["a", "b", "c"]).observations)
with gem.make_vec("script:Computing-v0", 2, size=4) as vector:
    print(vector.reset()[0], vector.step(["a", "b"]).observations)
plan = [gem.PlanItem(id="script:Lambda-v0", kwargs={"size": 9})]
with gem.make_vec("script:Local-v0", backend="process", plan=plan) as vector:
    print(vector.reset()[0])
'''


def test_environments_that_a_script_defines_work_in_processes(tmp_path: Path) -> None:
    """Also lambdas and wrappers that are functions, and without ``if __name__ == "__main__"``."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    run = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=LONGEST_S, check=False)
    assert run.stderr == ""
    once = "['start 3', 'start 5', 'start 3'] ['HEARD A', 'HEARD B', 'HEARD C']\n"
    assert run.stdout == once * 2 + "['start 4', 'start 4'] ['heard a', 'heard b']\n['start 9']\n"


def test_fork_of_a_program_leaves_its_workers_alone() -> None:
    """A child that ends closes nothing of its parent's."""
    process = program(
        f"vector = begin({INLINE!r}, 2, 'process')\n"
        "child = os.fork()\n"
        "if not child:\n    del vector\n    import gc; gc.collect(); sys.exit(0)\n"
        "os.waitpid(child, 0)\n"
        "print(vector.step(['a', 'b']).truncated.tolist(), vector.faults, flush=True)\n"
    )
    out, errors = process.communicate(timeout=LONGEST_S)
    assert out.splitlines()[1:] == ["[False, False] 0"], errors
