"""``TerminalEnv`` on real machines: an episode from end to end, many at once, and nothing left however it ends."""

from __future__ import annotations

import re
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from docker_machines import left as left_on_engine
from docker_machines import needs_engine, soon
from task_writing import TERMINAL_BENCH, write

import gem_core as gem

pytestmark = needs_engine


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The label of all that a test makes."""
    name = f"test-{secrets.token_hex(6)}"
    monkeypatch.setenv("GEM_TERMINAL_RUN", name)
    yield name
    assert soon(lambda: left(name) == []), left(name)


def left(run: str) -> list[str]:
    """Return what of a run is there: on the engine but for built images, and as processes."""
    found = [what for what in left_on_engine(run) if "'gem-terminal:" not in what]
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"GEM_TERMINAL_RUN={run}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_text("utf-8", "replace"))
        except OSError:
            continue
    return found


@pytest.mark.parametrize(
    "command",
    [
        "cp /bin/true /bin/bash.new; mv /bin/bash.new /bin/bash; kill -9 $$",
        "cp /bin/true /bin/sh.new; mv /bin/sh.new /bin/sh; kill -9 $$",
        "rm -f /bin/bash /bin/sh /bin/dash; while :; do :; done",
    ],
)
def test_an_agent_without_a_shell_has_failed(command: str, run: str) -> None:
    """What it does to its own shell is scored, and no error that would be left out."""
    env = gem.make("terminal:Sample", command_timeout_s=1.0)
    env.reset(options={"task": "count-errors"})
    _, reward, terminated, truncated, info = env.step(f"<bash>{command}</bash>")
    if not terminated:
        _, reward, terminated, truncated, info = env.step("<bash>true</bash>")
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert "error" not in info
    env.close()


@pytest.mark.parametrize(("where", "expected"), [("machine", (1.0, "shell")), ("judge", (0.0, "judge"))])
def test_tests_see_the_agents_shell_where_the_task_asks_for_it(
    run: str, tmp_path: Path, where: Any, expected: Any
) -> None:
    """Its variables and directory; not in a judge, which has only the folder."""
    says = "instruction: Write 5 to $FILE.\nrun_tests_in_same_shell: true\n"
    test = "echo == short test summary info ==; [ $(cat $FILE) = 5 ] && echo PASSED a::five || echo FAILED a::five"
    write(tmp_path / "five", TERMINAL_BENCH, {"task.yaml": says, "run-tests.sh": f"seq 5000\n{test}\nseq 5000\n"})
    env = gem.make("terminal:Folder", path=tmp_path, verify_in=where, max_output=100, pool_size=0)
    env.reset(seed=1)
    env.step("<bash>export FILE=five; echo 5 >five</bash>")
    _, reward, _, _, info = env.step("<finish/>")
    assert (reward, info["verifier"]["where"]) == expected, info
    env.close()


def test_many_environments_at_once(run: str) -> None:
    """Sixteen in threads, each with a machine and a shell of its own."""
    vec = gem.make_vec("terminal:Sample", 16, seed=1, memory_mb=128, max_turns=3, pool_size=0, autoreset="disabled")
    vec.reset()
    for turn in range(2):
        step = vec.step([f"<bash>echo $(( {index} + {turn} ))</bash>" for index in range(16)])
        assert [int(observation.split()[0]) for observation in step.observations] == list(range(turn, 16 + turn))
    vec.close()


FORGETFUL = """
import gem_core as gem
env = gem.make("terminal:Sample", pool_size=2, prestart=False)
env.reset(seed=1)
env.step("<bash>sleep 1000 &</bash>")
print("ready", flush=True)
"""
WAIT = "import time; time.sleep(1000)"


@pytest.mark.parametrize(
    ("end", "sent"), [("raise ValueError('a bug')", None), (WAIT, signal.SIGINT), (WAIT, signal.SIGKILL)]
)
def test_program_that_never_closes_leaves_nothing(run: str, end: str, sent: int | None) -> None:
    """After an exception and Ctrl-C; what a ``kill -9`` has left goes when the same user starts another machine."""
    with subprocess.Popen([sys.executable, "-c", FORGETFUL + end], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "ready\n"
        if sent:
            program.send_signal(sent)
        assert program.wait(timeout=120) != 0
    if sent == signal.SIGKILL:
        subprocess.run([sys.executable, "-c", FORGETFUL], check=True, capture_output=True, timeout=300)


def test_interrupted_run_leaves_nothing(run: str, tmp_path: Path) -> None:
    """Ctrl-C in ``gem run terminal:Sample``: exit code 130, one line, and no container."""
    lines = tmp_path / "run.jsonl"
    words = [sys.executable, "-m", "gem_core", "run", "terminal:Sample", "--agent", "random", "--episodes", "1000"]
    words += ["--num-envs", "3", "--out", str(lines)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as program:
        assert soon(lambda: lines.exists() and lines.stat().st_size)
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=180)
    assert program.returncode == 130, errors
    assert "Traceback" not in errors


def test_container_that_somebody_else_removed_is_an_error_and_the_next_episode_goes_on(run: str) -> None:
    """It is nobody's failure that training should learn from."""
    env = gem.make("terminal:Sample", pool_size=0)
    env.reset(seed=1)
    words = " ".join(what for what in left_on_engine(run) if what.startswith("container"))
    command = ["docker", "rm", "--force", *re.findall(r"'/([^']+)'", words)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    _, reward, terminated, truncated, info = env.step("<bash>ls</bash>")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] in ("machine", "engine")
    env.reset(seed=1)
    assert env.step("<bash>echo again</bash>")[0].startswith("again\n")
    env.close()
