"""``gem terminal``: what it shows, its errors in one line, and its exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from docker_machines import BASE, left, needs_engine, soon
from task_writing import HARBOR, TERMINAL_BENCH, write

TASK = "[agent]\ntimeout_sec = 30\n[verifier]\ntimeout_sec = 20\n[environment]\nmemory_mb = 256\n"
JUDGE = "if {test}; then reward=1; else reward=0; fi\necho $reward >/logs/verifier/reward.txt\n"


def gem(*words: str, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "gem_core", *words]
    variables = {**os.environ, "GEM_TERMINAL_RUN": "test-check", **more}
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, timeout=300, check=False)


def checked(cwd: Path, *words: str) -> dict[str, dict[str, Any]]:
    """Return what a check says of each task."""
    done = gem("terminal", "check", *words, "--json", cwd=cwd)
    assert done.stdout, done.stderr
    rows = {row["task"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert done.returncode == (0 if all(row["sound"] for row in rows.values()) else 1)
    return rows


def write_task(
    folder: Path, test: str = "grep -q done /app/note", solution: str = "echo done >/app/note", settings: str = TASK
) -> Path:
    """Write a task whose tests and solution are a line of shell each."""
    files = {"environment/Dockerfile": f"FROM {BASE}\nWORKDIR /app\n", "tests/test.sh": JUDGE.replace("{test}", test)}
    return write(folder, HARBOR, {"task.toml": settings, "solution/solve.sh": f"#!/bin/bash\n{solution}\n"}, files)


def test_list_shows_tasks_limits_notes_and_what_is_broken(tmp_path: Path) -> None:
    """A table, a note once for all tasks that have it, and as JSON all that is known."""
    for name in ("one", "two"):
        settings = f"{TASK}skills_dir = 'x'\n"
        write_task(tmp_path / "tasks" / name, "curl -LsSf https://example.org/install.sh | sh", settings=settings)
    write(tmp_path / "tasks" / "worse", {"task.toml": "this is no TOML"})
    done = gem("terminal", "list", "tasks", cwd=tmp_path, DOCKER_HOST=f"unix://{tmp_path}/no.sock")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["task", "format", "difficulty", "agent", "tests", "memory", "network", "here"]
    assert lines[1].split() == ["one", "harbor", "-", "30", "s", "20", "s", "256", "MB", "none", "no"]
    assert [line.partition(": ")[0] for line in lines[3:]] == ["2 tasks", "one and 1 more", "one and 1 more", "worse"]
    rows = json.loads(gem("terminal", "list", "tasks", "--json", cwd=tmp_path).stdout)
    assert [row["name"] for row in rows] == ["one", "two", "worse"]
    assert rows[0]["memory_mb"] == 256
    assert "task.toml" in rows[2]["broken"]


@needs_engine
def test_list_says_what_a_task_does_not_get(tmp_path: Path) -> None:
    """Of memory, as many megabytes as no computer has."""
    write_task(tmp_path / "one", settings="[environment]\nmemory_mb = 9000000000\nstorage_mb = 10240\n")
    (row,) = json.loads(gem("terminal", "list", "one", "--storage-mb", "5000", "--json", cwd=tmp_path).stdout)
    assert row["cannot_run"] == ""
    assert ["memory" in row["shortfall"][0], "storage_mb=5000" in row["shortfall"][1]] == [True, True]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("list nowhere", 2, "nowhere"),
        ("check one --task tow", 2, "'tow'"),
        ("check one --build-arg BASE", 2, "NAME=VALUE"),
        ("check one --variable KEY", 2, "'KEY'"),
        ("check one", 1, "no.sock"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, words: str, code: int, said: str) -> None:
    """They name what was wrong, and the exit code tells usage from failure, as of a missing engine."""
    write_task(tmp_path / "one")
    done = gem("terminal", *words.split(), cwd=tmp_path, DOCKER_HOST=f"unix://{tmp_path}/no.sock")
    (line,) = done.stderr.splitlines()
    assert (done.returncode, line[:5], said in line) == (code, "gem: ", True)


def test_info_tells_of_an_environment_that_cannot_run_here(tmp_path: Path) -> None:
    """With its options, its turns, and why there is no observation."""
    done = gem("info", "terminal:Sample", cwd=tmp_path, DOCKER_HOST=f"unix://{tmp_path}/no.sock")
    assert (done.returncode, done.stderr) == (0, "")
    assert "  turn limit:   50\n" in done.stdout
    assert "no container engine answers at unix://" in done.stdout


@needs_engine
def test_check_tells_sound_tasks_from_others(tmp_path: Path) -> None:
    """Why each fails; one whose image cannot be built does not keep the others from being tried."""
    tasks = tmp_path / "tasks"
    write_task(tasks / "easy", test="true")
    write_task(tasks / "good")
    write_task(tasks / "wrong", test="echo seen $(cat /app/note); false")
    write(write_task(tasks / "unbuilt"), {"environment/Dockerfile": f"FROM {BASE}\nRUN echo nearly there; exit 7\n"})
    write_task(tasks / "memory", solution="python3 -c 'x = bytearray(200 << 20)' && echo done >/app/note", settings="")
    tests = 'test "$word" = done && said=PASSED || said=FAILED\necho "=== short test summary info ==="\n'
    shell = {
        "task.yaml": "instruction: Set word.\nrun_tests_in_same_shell: true\nparser_name: pytest\n",
        "Dockerfile": f"FROM {BASE}\nWORKDIR /app\n",
        "solution.yaml": "- command: export word=done\n",
        "run-tests.sh": tests + 'echo "$said tests/test_outputs.py::test_word"\n',
    }
    write(tasks / "shell", TERMINAL_BENCH, shell)
    rows = checked(tmp_path, "tasks", "--memory-mb", "100")
    assert rows["easy"]["why"] == "doing nothing passes"
    assert rows["good"]["sound"]
    assert rows["wrong"]["why"].startswith("the reference solution fails by hand too: the score is 0")
    assert rows["wrong"]["why"].endswith("seen done")
    assert "nearly there" in rows["unbuilt"]["why"]
    assert rows["memory"]["why"].startswith("the reference solution fails only under GEM's limits")
    assert rows["shell"]["solution"] == "passes"
    write_task(tasks / "elsewhere", "grep -q done /tmp/note", "echo done >/tmp/note")
    rows = checked(tmp_path, "tasks", "--verify-in", "judge", "--task", "good", "--task", "elsewhere")
    assert rows["good"]["sound"]
    assert rows["elsewhere"]["why"].startswith("the reference solution fails only under judge")


@needs_engine
def test_interrupted_check_ends_without_waiting_for_tests(tmp_path: Path) -> None:
    """Ctrl-C removes the machines, so that what runs in them comes to its end."""
    run = f"test-interrupt-{os.getpid()}"
    write_task(tmp_path / "slow", test="sleep 1000", settings="[verifier]\ntimeout_sec = 900\n")
    words = [sys.executable, "-m", "gem_core", "terminal", "check", "slow"]
    env = {**os.environ, "GEM_TERMINAL_RUN": run}
    with subprocess.Popen(words, cwd=tmp_path, env=env, stderr=subprocess.PIPE, text=True) as program:
        assert soon(lambda: any(what.startswith("container") for what in left(run)))
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=200)
    assert (program.returncode, errors.split()) == (130, ["gem:", "interrupted"])
    assert [what for what in left(run) if not what.startswith("image")] == []
