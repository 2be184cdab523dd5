"""``TerminalEnv`` on real machines: an episode from end to end, many at once, and nothing left however it ends."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from docker_machines import left as left_on_engine
from docker_machines import needs_engine
from task_writing import TERMINAL_BENCH, write

import gem_core as gem

TASK = "count-errors"

pytestmark = needs_engine


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The label of all that a test makes."""
    name = f"test-{secrets.token_hex(6)}"
    monkeypatch.setenv("GEM_TERMINAL_RUN", name)
    yield name
    assert left(name) == []


def left(run: str) -> list[str]:
    """Return what of a run is there: on the engine but for built images, and as processes."""
    return [what for what in left_on_engine(run) if "'gem-terminal:" not in what] + processes(run)


def processes(run: str) -> list[str]:
    """Return the processes of a run but this one."""
    mark = f"GEM_TERMINAL_RUN={run}".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if int(folder.name) != os.getpid() and mark in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_text("utf-8", "replace").replace("\0", " ")[:100])
        except OSError:
            continue
    return found


def soon_nothing(run: str) -> list[str]:
    """Return what is left after a while; processes of containers end a moment after the containers."""
    until = time.monotonic() + 60
    while (found := left(run)) and time.monotonic() < until:
        time.sleep(0.2)
    return found


@pytest.mark.parametrize(
    "command",
    [
        "cp /bin/true /bin/bash.new; mv /bin/bash.new /bin/bash; kill -9 $$",
        "cp /bin/true /bin/sh.new; mv /bin/sh.new /bin/sh; kill -9 $$",
        "rm -f /bin/bash /bin/sh /bin/dash; kill -9 $$",
        "rm -f /bin/bash /bin/sh /bin/dash; while :; do :; done",
    ],
)
def test_an_agent_without_a_shell_has_failed(command: str, run: str) -> None:
    """What it does to its own shell is scored, and no error that would be left out."""
    env = gem.make("terminal:Sample", command_timeout_s=1.0)
    env.reset(options={"task": TASK})
    _, reward, terminated, truncated, info = env.step(f"<bash>{command}</bash>")
    if not terminated:
        _, reward, terminated, truncated, info = env.step("<bash>true</bash>")
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert "error" not in info
    env.close()


@pytest.mark.parametrize("where", ["machine", "judge"])
def test_tests_see_the_agents_shell_where_the_task_asks_for_it(run: str, tmp_path: Path, where: Any) -> None:
    """Its variables and directory; not in a judge, which has only the folder."""
    test = (
        "echo ===== short test summary info =====; [ $(cat $FILE) = 5 ] && echo PASSED a::five || echo FAILED a::five"
    )
    says = "instruction: Write 5 to $FILE.\nrun_tests_in_same_shell: true\n"
    write(tmp_path / "five", TERMINAL_BENCH, {"task.yaml": says, "run-tests.sh": f"seq 5000\n{test}\nseq 5000\n"})
    env = gem.make("terminal:Folder", path=tmp_path, verify_in=where, max_output=100, pool_size=0)
    env.reset(seed=1)
    env.step("<bash>export FILE=five; echo 5 >five</bash>")
    _, reward, _, _, info = env.step("<finish/>")
    assert (reward, info["verifier"]["where"]) == ((1.0, "shell") if where == "machine" else (0.0, "judge")), info
    env.close()


def test_many_environments_at_once(run: str) -> None:
    """Thirty-two in threads, each with a machine and a shell of its own."""
    many = 32
    vec = gem.make_vec("terminal:Sample", many, seed=1, memory_mb=128, max_turns=3, pool_size=0, autoreset="disabled")
    vec.reset()
    for turn in range(2):
        step = vec.step([f"<bash>echo $(( {index} + {turn} ))</bash>" for index in range(many)])
        for index, observation in enumerate(step.observations):
            assert observation.startswith(f"{index + turn}\n"), observation
    vec.close()


_FORGETFUL = """
import gem_core as gem
env = gem.make("terminal:Sample", pool_size=2, prestart=False)
env.reset(seed=1)
env.step("<bash>sleep 1000 &</bash>")
print("ready", flush=True)
{end}
"""


@pytest.mark.parametrize("end", ["pass", "raise ValueError('a bug')", "import time; time.sleep(1000)"])
def test_program_that_never_closes_leaves_nothing(run: str, end: str) -> None:
    """At its end, after an exception, and after Ctrl-C."""
    words = [sys.executable, "-c", _FORGETFUL.format(end=end)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        if "sleep(1000)" in end:
            program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=120)
    assert ("ValueError" in errors) == ("ValueError" in end), errors
    assert soon_nothing(run) == []


def test_killed_program_is_cleared_up_after_by_the_next(run: str) -> None:
    """Whatever a ``kill -9`` has left goes when the same user starts another machine."""
    words = [sys.executable, "-c", _FORGETFUL.format(end="import time; time.sleep(1000)")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        program.kill()
    subprocess.run([sys.executable, "-c", _FORGETFUL.format(end="")], check=True, capture_output=True, timeout=300)
    assert soon_nothing(run) == []


def test_interrupted_run_leaves_nothing(run: str, tmp_path: Path) -> None:
    """Ctrl-C in ``gem run terminal:Sample``: exit code 130, one line, and no container."""
    words = [sys.executable, "-m", "gem_core", "run", "terminal:Sample", "--agent", "random", "--episodes", "1000"]
    words += ["--num-envs", "3", "--out", str(tmp_path / "run.jsonl")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as program:
        until = time.monotonic() + 240
        while not _has_lines(tmp_path / "run.jsonl") and program.poll() is None and time.monotonic() < until:
            time.sleep(0.1)
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=180)
    assert program.returncode == 130, errors
    assert "Traceback" not in errors
    assert soon_nothing(run) == []


def _has_lines(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def test_container_that_somebody_else_removed_is_an_error_and_the_next_episode_goes_on(run: str) -> None:
    """It is nobody's failure that training should learn from."""
    env = gem.make("terminal:Sample", pool_size=0)
    env.reset(seed=1)
    names = [
        what.split()[-1].lstrip("['/").rstrip("']") for what in left_on_engine(run) if what.startswith("container")
    ]
    subprocess.run(["docker", "rm", "--force", *names], check=True, capture_output=True, timeout=60)
    _, reward, terminated, truncated, info = env.step("<bash>ls</bash>")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] in ("machine", "engine")
    env.reset(seed=1)
    assert env.step("<bash>echo again</bash>")[0].startswith("again\n")
    env.close()


@pytest.mark.thorough
def test_soak(run: str) -> None:
    """Episodes while workers and containers are killed at random; nothing is left."""
    script = Path(__file__).parents[3] / "scripts" / "terminal_soak.py"
    words = [sys.executable, str(script), "--episodes", "6", "--num-envs", "2", "--every", "2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
