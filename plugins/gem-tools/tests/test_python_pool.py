"""The pool of sandboxes: its turn of calls, its sessions, its faults, and what is left when it ends."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from python_levels import ALL, folders, pool_of, processes, until

from gem_tools.python import Limits, Outcome, Pool, SandboxError, shared_pool


@pytest.fixture(params=ALL)
def pool(request: pytest.FixtureRequest) -> Iterator[Pool]:
    """A pool of two sandboxes of each level."""
    made = pool_of(request.param, workers=2)
    yield made
    made.close()


def alive(pid: int) -> bool:
    """Tell whether a process is there and has not ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(") ")[2].split()[0]
    except OSError:
        return False
    return state not in ("Z", "X")


def open_files() -> set[str]:
    """Return what this process has open."""
    found = set()
    for name in os.listdir("/proc/self/fd"):
        try:
            found.add(f"{name} {os.readlink(f'/proc/self/fd/{name}')}")
        except OSError:
            continue
    return found


# Calls.


def test_a_program_runs_as_main_with_its_input(pool: Pool) -> None:
    """As if it had been started by itself."""
    code = """
import sys
if __name__ == "__main__":
    print(sum(int(line) for line in sys.stdin), sys.argv)
"""
    outcome = pool.run(code, stdin="1\n2\n3\n")
    assert (outcome.status, outcome.exit_code) == ("ok", 0), outcome
    assert outcome.stdout == "6 ['<python>']\n"
    assert outcome.value is None
    assert 0 < outcome.wall_s < 60
    assert outcome.cpu_s > 0


@pytest.mark.thorough
def test_the_usual_libraries_work(pool: Pool) -> None:
    """Those that fork, start threads, use shared memory or temporary files as well."""
    if pool.level == "docker":
        pytest.skip("calls of a container have no shared memory, which multiprocessing needs for locks")
    code = """
import asyncio, concurrent.futures, decimal, multiprocessing, sqlite3, subprocess, tempfile, threading
async def one(): return 1
print(asyncio.run(one()))
with concurrent.futures.ThreadPoolExecutor(2) as threads: print(list(threads.map(abs, [-1, 2])))
context = multiprocessing.get_context("fork")
with context.Pool(2) as workers: print(workers.map(abs, [-3, 4]))
lock = context.Lock()
with lock, tempfile.NamedTemporaryFile() as file: file.write(b"x")
print(sqlite3.connect("data.db").execute("select 1 + 1").fetchone())
print(subprocess.run(["/bin/echo", "hello"], capture_output=True, text=True).stdout)
process = subprocess.Popen(["/bin/sleep", "60"]); process.terminate() if False else process.kill() if False else None
"""
    outcome = pool.run(code, limits=Limits(wall_s=60, processes=32))
    if pool.level == "process" and os.geteuid() != 0:
        pytest.skip("signals to others are refused to an ordinary user")
    assert (outcome.status, outcome.stdout) == ("ok", "1\n[1, 2]\n[3, 4]\n(2,)\nhello\n\n"), outcome


@pytest.mark.thorough
def test_numpy_works_preloaded_or_not(pool: Pool) -> None:
    """And draws other numbers in each call."""
    code = "import numpy, random\nprint(numpy.random.random(), random.random(), numpy.ones((500, 500)).sum())"
    outcomes = [pool.run(code, limits=Limits(wall_s=60)) for _ in range(2)]
    if pool.level == "docker" and outcomes[0].error == "ModuleNotFoundError: No module named 'numpy'":
        pytest.skip("the image has no numpy")
    warm = Pool(pool.sandbox, preload=["numpy", "no_such_module"], num_workers=1)
    try:
        outcomes += [warm.run(code, limits=Limits(wall_s=60)) for _ in range(2)]
    finally:
        warm.close()
    assert {outcome.status for outcome in outcomes} == {"ok"}, outcomes
    assert len({outcome.stdout.split()[0] for outcome in outcomes}) == 4
    assert len({outcome.stdout.split()[1] for outcome in outcomes}) == 4
    assert {outcome.stdout.split()[2] for outcome in outcomes} == {"250000.0"}


@pytest.mark.thorough
def test_a_thousand_calls_at_once(pool: Pool) -> None:
    """All are answered, each with its own output, in the order of their coming."""
    finished: list[int] = []

    async def one(number: int) -> Outcome:
        outcome = await pool.arun(f"print({number})", limits=Limits(wall_s=60))
        finished.append(number)
        return outcome

    async def all_of_them() -> list[Outcome]:
        return await asyncio.gather(*(one(number) for number in range(1000)))

    outcomes = asyncio.run(all_of_them())
    assert [outcome.stdout for outcome in outcomes] == [f"{number}\n" for number in range(1000)]
    # While one sandbox is at a long call, the other goes on; threads hand over between two loops. So there may be few
    # that later ones have overtaken, but by how many of those is a matter of the machine.
    latest, most_waiting = -1, 0
    for done, number in enumerate(finished, start=1):
        latest = max(latest, number)
        most_waiting = max(most_waiting, latest + 1 - done)
    assert most_waiting <= 20


def test_a_cancelled_call_is_ended(pool: Pool) -> None:
    """Its process goes at once, and its sandbox serves the next."""

    async def cancelled() -> None:
        calls = [asyncio.create_task(pool.arun("while True: pass", limits=Limits(wall_s=600))) for _ in range(6)]
        await asyncio.to_thread(until, lambda: len(pool.idle) == 0)
        for call in calls:
            call.cancel()
        assert [type(each) for each in await asyncio.gather(*calls, return_exceptions=True)] == [
            asyncio.CancelledError
        ] * 6

    asyncio.run(cancelled())
    with ThreadPoolExecutor(2) as threads:
        assert [each.stdout for each in threads.map(pool.run, ["print('next')"] * 2)] == ["next\n"] * 2


# Sessions.


@pytest.mark.few(1)
def test_sessions_keep_their_variables_apart(pool: Pool) -> None:
    """Many at once, in a few sandboxes."""
    sessions = [pool.session(Limits(wall_s=30)) for _ in range(20)]
    for number, session in enumerate(sessions):
        session.run(f"x = {number}\nopen('x', 'w').write(str(x))")
    assert [session.run("x, open('x').read()").value for session in sessions] == [f"({n}, '{n}')" for n in range(20)]
    with ThreadPoolExecutor(8) as threads:
        values = list(threads.map(lambda s: s.run("x += 100\nx").value, sessions))
    assert values == [str(n + 100) for n in range(20)]
    for session in sessions:
        session.close()
        session.close()
    assert until(lambda: len(folders(pool)) <= 8)


@pytest.mark.thorough
def test_a_session_rests_between_its_calls(pool: Pool) -> None:
    """What it started is gone, and its threads stand still."""
    session = pool.session(Limits(wall_s=30))
    session.run("""
import os, threading, time
count = 0
def work():
    global count
    while True:
        count += 1
        time.sleep(0.0001)
threading.Thread(target=work, daemon=True).start()
if os.fork() == 0:
    while True: time.sleep(1)
child = True
""")
    first = int(session.run("count").value or 0)
    pool.run("import time\ntime.sleep(0.3)")
    second = int(session.run("count").value or 0)
    assert second - first < 1000
    assert session.run(
        "import os\ntry:\n    os.waitpid(-1, os.WNOHANG)\nexcept ChildProcessError:\n    print('none')"
    ).stdout
    session.close()


@pytest.mark.thorough
def test_limits_hold_for_each_call_of_a_session(pool: Pool) -> None:
    """Time begins anew with each call."""
    session = pool.session(Limits(wall_s=60, cpu_s=1, output_bytes=100))
    for _ in range(3):
        outcome = session.run("import time\nend = time.process_time() + 0.5\nwhile time.process_time() < end: pass")
        assert outcome.status == "ok", outcome
    assert session.run("print('x' * 1000)").dropped_bytes == 901
    assert session.run("1", stdin="unused").value == "1"
    assert session.run("input()", stdin="a line\n").value == "'a line'"
    lost = session.run("while True: pass")
    assert (lost.status, lost.session_lost) == ("cpu", True)
    assert session.run("1 + 1").value == "2"
    session.close()


def test_a_session_whose_code_ends_its_process(pool: Pool) -> None:
    """Says so, and begins anew."""
    session = pool.session(Limits(wall_s=30))
    session.run("x = 1")
    outcome = session.run("import os\nos._exit(3)")
    assert (outcome.status, outcome.exit_code, outcome.session_lost) == ("exit", 3, True)
    assert session.run("x").error == "NameError: name 'x' is not defined"
    session.run("import os\nos.close(3)")
    assert session.run("2").value == "2"
    session.close()


# Faults of the machinery.


@pytest.mark.few(1)
def test_a_sandbox_that_dies_is_replaced(pool: Pool) -> None:
    """Calls in it fail as faults of the machinery, whatever the code; others go on."""
    outcomes: list[object] = []

    def call() -> None:
        try:
            outcomes.append(pool.run("import time\ntime.sleep(600)", limits=Limits(wall_s=1000)))
        except SandboxError as error:
            outcomes.append(error)

    threads = [threading.Thread(target=call) for _ in range(2)]
    for thread in threads:
        thread.start()
    assert until(lambda: len(pool.idle) == 0 and len(pool.cells) == 2)
    old = list(pool.cells)
    pids = processes(pool)
    for cell in old:
        assert cell.process is not None
        os.kill(cell.process.pid, signal.SIGKILL)
    for thread in threads:
        thread.join()
    assert [str(outcome) for outcome in outcomes] == ["the sandbox was lost"] * 2
    assert pool.run("print('again')").stdout == "again\n"
    assert not set(old) & set(pool.cells)
    assert until(lambda: not any(map(alive, pids)))
    for cell in old:
        assert until(lambda base=cell.launch.base: base is None or not os.path.exists(base))


@pytest.mark.thorough
def test_a_session_in_a_sandbox_that_died_is_lost(pool: Pool) -> None:
    """Its next call says so, the one after that begins anew."""
    session = pool.session(Limits(wall_s=30))
    session.run("x = 1")
    assert session.cell is not None
    assert session.cell.process is not None
    os.kill(session.cell.process.pid, signal.SIGKILL)
    assert until(lambda: session.cell is None or not session.cell.alive)
    with pytest.raises(SandboxError):
        session.run("x")
    assert session.run("1").value == "1"
    session.close()


def test_a_closed_pool_refuses_calls(pool: Pool) -> None:
    """And has ended all that it had."""
    pids = processes(pool)
    session = pool.session()
    session.run("1")
    pool.close()
    pool.close()
    with pytest.raises(SandboxError, match="the pool is closed"):
        pool.run("1")
    with pytest.raises(SandboxError):
        session.run("1")
    session.close()
    assert until(lambda: not any(map(alive, pids)))


@pytest.mark.thorough
def test_closing_a_pool_ends_the_calls_in_it(pool: Pool) -> None:
    """Those that run, and those that wait; nobody is left waiting."""
    outcomes: list[str] = []

    def call() -> None:
        try:
            pool.run("import time\ntime.sleep(600)", limits=Limits(wall_s=1000))
        except SandboxError as error:
            outcomes.append(str(error))

    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert until(lambda: len(pool.cells) == 2 and len(pool.idle) == 0 and len(pool.waiting) == 2)
    pool.close()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == ["the pool was closed"] * 2 + ["the sandbox was closed"] * 2


@pytest.mark.thorough
def test_a_sandbox_that_hangs_is_given_up(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its keeper is stopped here; the call fails as a fault of the machinery, and the next is served."""
    monkeypatch.setattr("gem_tools.python.sandbox.GRACE_S", 0.2)
    for cell in pool.cells:
        for pid in processes(pool):
            os.kill(pid, signal.SIGSTOP)
        assert cell.alive
    with pytest.raises(SandboxError, match="the sandbox was closed"):
        pool.run("1", limits=Limits(wall_s=0.2))
    monkeypatch.undo()
    assert pool.run("print('next')", limits=Limits(wall_s=60)).stdout == "next\n"


@pytest.mark.thorough
def test_a_forked_process_has_sandboxes_of_its_own(pool: Pool) -> None:
    """And leaves those of its parent alone."""
    assert pool.run("print(1)").ok
    cells = list(pool.cells)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            same = {cell.process.pid for cell in cells if cell.process} & {
                cell.process.pid for cell in pool.cells if cell.process
            }
            os.write(writing, f"{len(same)} {pool.run('print(40 + 2)').stdout}".encode())
            pool.close()
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with open(reading, encoding="utf-8") as stream:
        assert stream.read() == "0 42\n"
    assert os.waitpid(child, 0)[1] == 0
    assert pool.run("print(2)").stdout == "2\n"
    assert pool.cells == cells


# What is left.


@pytest.mark.thorough
def test_nothing_is_left_after_many_calls(pool: Pool) -> None:
    """No process, no file, no socket, no memory; neither here nor in the sandboxes."""

    async def some(count: int) -> None:
        codes = ["print(1)", "1 / 0", "open('f', 'w').write('x' * 1000)", "import os\nos._exit(1)"]
        calls = [pool.arun(codes[number % 4], limits=Limits(wall_s=60)) for number in range(count)]
        await asyncio.gather(*calls)

    def rest() -> None:
        assert until(lambda: len(pool.idle) == 2)
        assert until(lambda: len(processes(pool)) == usual)

    asyncio.run(some(20))
    usual = 2 * (4 if pool.level == "bubblewrap" else 2)
    rest()
    before, files = open_files(), sandbox_files(pool)
    asyncio.run(some(400))
    rest()
    assert open_files() == before
    # The next process may still have been closing what it inherited when the first count was taken.
    assert until(lambda: sum(sandbox_files(pool)) <= sum(files))
    assert len(folders(pool)) <= 8


def sandbox_files(pool: Pool) -> list[int]:
    """Return how many files each process of the sandboxes has open."""
    counts = []
    for pid in processes(pool):
        try:
            counts.append(len(os.listdir(f"/proc/{pid}/fd")))
        except OSError:
            continue
    return sorted(counts)


PROGRAM = """
import sys, threading, time
sys.path[:0] = {path!r}
from gem_tools.python import Limits
from python_levels import new_pool, processes, until
pool = new_pool({level!r}, 2)
pool.start()
session = pool.session(Limits(wall_s=1000))
session.run("x = 1")
code = "import os, time\\nos.fork()\\nopen('f', 'w').write('x')\\ntime.sleep(1000)"
thread = threading.Thread(target=pool.run, args=(code,), kwargs={{"limits": Limits(wall_s=1000)}}, daemon=True)
thread.start()
until(lambda: len(processes(pool)) >= {least})
print(*processes(pool), flush=True)
print(*[cell.launch.base for cell in pool.cells if cell.launch.base], flush=True)
{end}
"""


@pytest.mark.thorough
@pytest.mark.parametrize("level", ALL)
@pytest.mark.parametrize("how", ["end", "exception", "interrupt", "kill", "terminate"])
def test_nothing_is_left_when_the_process_ends(level: str, how: str) -> None:
    """By itself, by an error, by Ctrl-C, by kill -9: with a call and a session in its sandboxes.

    The process waits again and again: a signal that comes just before it blocks is noticed when it wakes.
    """
    pool_of(level).close()
    end = {"end": "", "exception": "raise ValueError"}.get(how, "while True:\n    threading.Event().wait(0.1)")
    path = [str(Path(__file__).parent), *filter(None, sys.path)]
    code = PROGRAM.format(path=path, level=level, end=end, least=5 if level == "bubblewrap" else 3)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    with process.stdout:
        pids = [int(word) for word in process.stdout.readline().split()]
        bases = process.stdout.readline().decode().split()
        assert len(pids) >= (5 if level == "bubblewrap" else 3)
        number = {"interrupt": signal.SIGINT, "kill": signal.SIGKILL, "terminate": signal.SIGTERM}.get(how)
        if number is not None:
            process.send_signal(number)
        try:
            process.wait(60)
        finally:
            process.kill()
    assert until(lambda: not any(map(alive, pids)))
    assert until(lambda: not any(map(os.path.exists, bases)))


@pytest.mark.thorough
def test_pools_are_shared_by_their_settings() -> None:
    """One set of sandboxes serves every tool with the same."""
    assert shared_pool() is shared_pool("auto")
    assert shared_pool(num_workers=3) is not shared_pool()
