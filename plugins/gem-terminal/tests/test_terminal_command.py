"""``gem terminal``: what it shows, its errors in one line, and its exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from docker_machines import BASE, left, needs_engine, variables
from task_writing import HARBOR, TERMINAL_BENCH, write

TASK = "[agent]\ntimeout_sec = 30\n[verifier]\ntimeout_sec = 20\n[environment]\nmemory_mb = 256\n"
JUDGE = "if {test}; then reward=1; else reward=0; fi\necho $reward >/logs/verifier/reward.txt\n"


def gem_terminal(*words: str, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "gem_core", "terminal", *words]
    variables = {**os.environ, **more}
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, timeout=300, check=False)


def checked(cwd: Path, *words: str) -> dict[str, dict[str, Any]]:
    """Return what a check says of each task."""
    done = gem_terminal("check", *words, "--json", cwd=cwd, GEM_TERMINAL_RUN="test-check")
    assert done.stdout, done.stderr
    rows = {row["task"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert done.returncode == (0 if all(row["sound"] for row in rows.values()) else 1)
    return rows


def write_task(
    folder: Path, test: str = "grep -q done /app/note", solution: str = "echo done >/app/note", settings: str = TASK
) -> Path:
    """Write a task whose tests and solution are a line of shell each."""
    files = {
        "task.toml": settings,
        "environment/Dockerfile": f"FROM {BASE}\nWORKDIR /app\n",
        "tests/test.sh": JUDGE.replace("{test}", test),
        "solution/solve.sh": f"#!/bin/bash\n{solution}\n",
    }
    return write(folder, HARBOR, files)


def test_list_shows_tasks_limits_notes_and_what_is_broken(tmp_path: Path) -> None:
    """A table, a note once for all tasks that have it, and as JSON all that is known."""
    for name in ("one", "two"):
        settings = f"{TASK}skills_dir = 'x'\n"
        write_task(tmp_path / "tasks" / name, "curl -LsSf https://example.org/install.sh | sh", settings=settings)
    write(tmp_path / "tasks" / "worse", {"task.toml": "this is no TOML"})
    done = gem_terminal("list", "tasks", cwd=tmp_path, DOCKER_HOST=f"unix://{tmp_path}/no.sock")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["task", "format", "difficulty", "agent", "tests", "memory", "network", "here"]
    assert lines[1].split() == ["one", "harbor", "-", "30", "s", "20", "s", "256", "MB", "none", "no"]
    assert [line.partition(": ")[0] for line in lines[3:]] == ["2 tasks", "one and 1 more", "one and 1 more", "worse"]
    rows = json.loads(gem_terminal("list", "tasks", "--json", cwd=tmp_path).stdout)
    assert [row["name"] for row in rows] == ["one", "two", "worse"]
    assert rows[0]["memory_mb"] == 256
    assert "task.toml" in rows[2]["broken"]


@needs_engine
def test_list_says_what_a_task_does_not_get(tmp_path: Path) -> None:
    """Of memory, as many megabytes as no computer has."""
    write_task(tmp_path / "one", settings="[environment]\nmemory_mb = 9000000000\nstorage_mb = 10240\n")
    (row,) = json.loads(gem_terminal("list", "one", "--storage-mb", "5000", "--json", cwd=tmp_path).stdout)
    assert row["cannot_run"] == ""
    assert "9e+09 MB of memory" in row["shortfall"][0]
    assert "storage_mb=5000" in row["shortfall"][1]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["list", "nowhere"], 2, "nowhere"),
        (["check", "one", "--task", "tow"], 2, "'tow'"),
        (["check", "one", "--build-arg", "BASE"], 2, "NAME=VALUE"),
        (["check", "one", "--variable", "KEY"], 2, "'KEY'"),
        (["check", "one"], 1, "no.sock"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, words: list[str], code: int, said: str) -> None:
    """They name what was wrong, and the exit code tells usage from failure, as of a missing engine."""
    write_task(tmp_path / "one")
    done = gem_terminal(*words, cwd=tmp_path, DOCKER_HOST=f"unix://{tmp_path}/no.sock")
    assert done.returncode == code
    assert done.stderr.startswith("gem: ")
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_info_tells_of_an_environment_that_cannot_run_here(tmp_path: Path) -> None:
    """With its options, its turns, and why there is no observation."""
    command = [sys.executable, "-m", "gem_core", "info", "terminal:Sample"]
    env = {**os.environ, "DOCKER_HOST": f"unix://{tmp_path}/no.sock"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=100, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "  turn limit:   50\n" in done.stdout
    assert "There is no observation to show: no container engine answers at unix://" in done.stdout


@needs_engine
def test_check_tells_sound_tasks_from_others(tmp_path: Path) -> None:
    """Why each fails; one whose image cannot be built does not keep the others from being tried."""
    tasks = tmp_path / "tasks"
    write_task(tasks / "easy", test="true")
    write_task(tasks / "good")
    write_task(tasks / "wrong", test="echo seen $(cat /app/note); false")
    write(write_task(tasks / "unbuilt"), {"environment/Dockerfile": f"FROM {BASE}\nRUN echo nearly there; exit 7\n"})
    rows = checked(tmp_path, "tasks")
    assert rows["easy"]["why"] == "doing nothing passes"
    assert rows["good"]["sound"]
    assert rows["wrong"]["why"].startswith("the reference solution fails by hand too: the score is 0")
    assert rows["wrong"]["why"].endswith("seen done")
    assert "nearly there" in rows["unbuilt"]["why"]
    assert "good  passes" in gem_terminal("check", "tasks/good", cwd=tmp_path).stdout


@needs_engine
def test_check_says_what_fails_only_under_limits_or_in_a_judge(tmp_path: Path) -> None:
    """By hand is without limits, and in the machine that the solution ran in."""
    memory = write_task(tmp_path / "memory", "true", "python3 -c 'x = bytearray(200 << 20)' && echo done >/app/note")
    write(memory, {"task.toml": "", "tests/test.sh": JUDGE.replace("{test}", "grep -q done /app/note")})
    why = checked(tmp_path, "memory", "--memory-mb", "100")["memory"]["why"]
    assert why.startswith("the reference solution fails only under GEM's limits")
    write_task(tmp_path / "tasks" / "carried")
    write_task(tmp_path / "tasks" / "elsewhere", "grep -q done /tmp/note", "echo done >/tmp/note")
    rows = checked(tmp_path, "tasks", "--verify-in", "judge")
    assert rows["carried"]["sound"]
    assert rows["elsewhere"]["why"].startswith("the reference solution fails only under judge")


@needs_engine
def test_check_runs_tests_in_the_shell_of_the_solution(tmp_path: Path) -> None:
    """A task that asks for it sees what the solution has left in its shell."""
    tests = 'test "$word" = done && said=PASSED || said=FAILED\necho "=== short test summary info ==="\n'
    files = {
        "task.yaml": "instruction: Set word.\nrun_tests_in_same_shell: true\nparser_name: pytest\n",
        "Dockerfile": f"FROM {BASE}\nWORKDIR /app\n",
        "solution.yaml": "- command: export word=done\n",
        "run-tests.sh": tests + 'echo "$said tests/test_outputs.py::test_word"\n',
    }
    write(tmp_path / "one", TERMINAL_BENCH, files)
    assert checked(tmp_path, "one")["one"]["solution"] == "passes"


@needs_engine
def test_interrupted_check_ends_without_waiting_for_tests(tmp_path: Path) -> None:
    """Ctrl-C removes the machines, so that what runs in them comes to its end."""
    run = f"test-interrupt-{os.getpid()}"
    write_task(tmp_path / "slow", test="sleep 1000", settings="[verifier]\ntimeout_sec = 900\n")
    words = [sys.executable, "-m", "gem_core", "terminal", "check", "slow"]
    with subprocess.Popen(words, cwd=tmp_path, env=variables(run), stderr=subprocess.PIPE, text=True) as program:
        until = time.monotonic() + 200
        while not any(what.startswith("container") for what in left(run)) and time.monotonic() < until:
            assert program.poll() is None
            time.sleep(0.1)
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=200)
    assert (program.returncode, errors.split()) == (130, ["gem:", "interrupted"])
    assert [what for what in left(run) if not what.startswith("image")] == []
