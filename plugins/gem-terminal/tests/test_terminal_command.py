"""``gem terminal``: what it shows, its errors in one line, and its exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from docker_machines import BASE, left
from machines import backend_names, environment, why_not
from task_writing import TERMINAL_BENCH, write

TASK = "[agent]\ntimeout_sec = 30\n[verifier]\ntimeout_sec = 20\n[environment]\nmemory_mb = 256\n"
DOCKERFILE = """ARG BASE=python:3.12-slim-bookworm
FROM ${BASE}
WORKDIR /app
COPY setup/ /opt/setup/
RUN sh /opt/setup/prepare.sh && rm -r /opt/setup
"""

each_backend = pytest.mark.parametrize("backend", backend_names())


def gem_terminal(*words: str, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "gem_core", "terminal", *words]
    variables = {**os.environ, **variables}
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, timeout=300, check=False)


def write_task(folder: Path, *, test: str = "grep -q done /app/note", prepare: str = "true") -> Path:
    """Write a task that both backends can run, and whose tests are one line of shell."""
    for name in ("environment/setup", "tests", "solution"):
        (folder / name).mkdir(parents=True)
    (folder / "task.toml").write_text('version = "1.0"\n' + TASK)
    (folder / "instruction.md").write_text("Write 'done' into /app/note.\n")
    (folder / "environment" / "setup" / "prepare.sh").write_text(f"{prepare}\n")
    (folder / "environment" / "Dockerfile").write_text(DOCKERFILE)
    judge = "if {test}; then reward=1; else reward=0; fi\necho $reward >/logs/verifier/reward.txt\n"
    (folder / "tests" / "test.sh").write_text(judge.replace("{test}", test))
    (folder / "solution" / "solve.sh").write_text("#!/bin/bash\necho done >/app/note\n")
    return folder


def test_list_shows_tasks_limits_and_what_is_broken(tmp_path: Path) -> None:
    """A table, and as JSON with all that is known."""
    write_task(tmp_path / "tasks" / "one")
    (tmp_path / "tasks" / "two").mkdir()
    (tmp_path / "tasks" / "two" / "task.toml").write_text("this is no TOML")
    done = gem_terminal("list", "tasks", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].split() == ["task", "format", "difficulty", "agent", "tests", "memory", "network", "here"]
    assert lines[1].split()[:9] == ["one", "harbor", "-", "30", "s", "20", "s", "256", "MB"]
    assert lines[-1].startswith("two: cannot be read: ")
    rows = json.loads(gem_terminal("list", "tasks", "--json", cwd=tmp_path).stdout)
    assert [row["name"] for row in rows] == ["one", "two"]
    assert rows[0]["memory_mb"] == 256
    assert "task.toml" in rows[1]["broken"]


def test_list_says_what_a_task_does_not_get(tmp_path: Path) -> None:
    """Of memory, as many megabytes as no computer has; where no engine answers, nothing is known."""
    folder = write_task(tmp_path / "one")
    (folder / "task.toml").write_text("[environment]\nmemory_mb = 9000000000\nstorage_mb = 10240\n")
    words = ("list", "one", "--storage-mb", "5000", "--json")
    done = gem_terminal(*words, cwd=tmp_path, GEM_TERMINAL_BACKEND="docker")
    (row,) = json.loads(done.stdout)
    found = [] if row["cannot_run"] else ["9e+09 MB of memory", "10240 MB of storage and gets 5000: storage_mb=5000"]
    assert len(row["shortfall"]) == len(found)
    assert all(words in said for words, said in zip(found, row["shortfall"], strict=True))


@pytest.mark.skipif(bool(why_not("docker")), reason=why_not("docker") or "there")
def test_check_runs_tests_in_the_shell_of_the_solution(tmp_path: Path) -> None:
    """A task that asks for it sees what the solution has left in its shell."""
    solution = "- command: export word=done\n"
    tests = 'test "$word" = done && said=PASSED || said=FAILED\necho "=== short test summary info ==="\n'
    write(
        tmp_path / "one",
        TERMINAL_BENCH,
        {
            "task.yaml": "instruction: Set word.\nrun_tests_in_same_shell: true\nparser_name: pytest\n",
            "Dockerfile": f"FROM {BASE}\nWORKDIR /app\n",
            "solution.sh": None,
            "solution.yaml": solution,
            "run-tests.sh": tests + 'echo "$said tests/test_outputs.py::test_word"\n',
        },
    )
    done = gem_terminal("check", "one", "--json", cwd=tmp_path, **environment("docker", "test-check"))
    row = json.loads(done.stdout)
    assert row["solution"] == "passes", row


@pytest.mark.skipif(bool(why_not("docker")), reason=why_not("docker") or "there")
def test_check_says_what_fails_only_under_limits(tmp_path: Path) -> None:
    """By hand is without them."""
    folder = write_task(tmp_path / "one", test="grep -q done /app/note")
    (folder / "solution" / "solve.sh").write_text("python3 -c 'x = bytearray(200 << 20)' && echo done >/app/note\n")
    (folder / "task.toml").write_text("")
    words = ("check", "one", "--memory-mb", "100", "--json")
    row = json.loads(gem_terminal(*words, cwd=tmp_path, **environment("docker", "test-check")).stdout)
    assert row["why"].startswith("the reference solution fails only under GEM's limits")


def test_list_shows_the_notes_of_tasks(tmp_path: Path) -> None:
    """What has no effect, and what a task will miss: once, where several have the same."""
    for name in ("one", "two"):
        folder = write_task(tmp_path / "tasks" / name, test="curl -LsSf https://example.org/install.sh | sh")
        (folder / "task.toml").write_text("[environment]\nskills_dir = 'x'\n")
    done = gem_terminal("list", "tasks", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-2:] == [
        "one and 1 more: note: task.toml: 'environment.skills_dir' has no effect: agents here have one terminal.",
        "one and 1 more: note: tests/test.sh: needs a network for 'curl -LsSf https://', it seems, and the task "
        "asks for none: network='public' gives it one, the agent included.",
    ]


def test_list_says_that_nothing_can_run_here(tmp_path: Path) -> None:
    """Without an engine the tasks are shown all the same, with the reason."""
    write_task(tmp_path / "one")
    address = f"unix://{tmp_path}/no.sock"
    done = gem_terminal("list", "one", "--backend", "docker", cwd=tmp_path, DOCKER_HOST=address)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1].split()[-1] == "no"
    assert done.stdout.splitlines()[2].startswith("one: ")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["list", "nowhere"], 2, "gem: "),
        (["build", "nowhere"], 2, "gem: "),
        (["check", "one", "--task", "tow"], 2, "gem: there is no task 'tow' among 1."),
        (["shell", "one"], 2, "gem: gem terminal shell needs a terminal"),
        (["list", "--backend", "podman"], 2, "gem: Invalid value for '--backend'"),
        (["build", "one", "--build-arg", "BASE"], 2, "gem: --build-arg takes NAME=VALUE, not 'BASE'"),
        (["check", "one", "--variable", "KEY"], 2, "gem: variables: 'KEY' is not in the environment;"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, words: list[str], code: int, said: str) -> None:
    """They say what was wrong, and the exit code tells usage from failure."""
    write_task(tmp_path / "one")
    done = gem_terminal(*words, cwd=tmp_path)
    assert done.returncode == code
    assert done.stderr.startswith(said)
    assert len(done.stderr.splitlines()) == 1


def test_missing_engine_is_one_line(tmp_path: Path) -> None:
    """With what to do."""
    write_task(tmp_path / "one")
    address = f"unix://{tmp_path}/no.sock"
    done = gem_terminal("build", "one", "--backend", "docker", cwd=tmp_path, DOCKER_HOST=address)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "no.sock" in done.stderr


def test_info_tells_of_an_environment_that_cannot_run_here(tmp_path: Path) -> None:
    """With its options, its turns, and why there is no observation."""
    command = [sys.executable, "-m", "gem_core", "info", "terminal:Sample"]
    variables = {**os.environ, "GEM_TERMINAL_BACKEND": "docker", "DOCKER_HOST": f"unix://{tmp_path}/no.sock"}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=100, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "  turn limit:   50\n" in done.stdout
    assert "There is no observation to show: no container engine answers at unix://" in done.stdout


@each_backend
def test_build_shows_the_end_of_the_log_of_what_fails(backend: str, tmp_path: Path) -> None:
    """And builds the others; the exit code is 1."""
    write_task(tmp_path / "tasks" / "good")
    write_task(tmp_path / "tasks" / "bad", prepare="echo nearly there; exit 7")
    done = gem_terminal("build", "tasks", cwd=tmp_path, **environment(backend, "test-build"))
    assert done.returncode == 1
    assert done.stdout.startswith("1 of 2 images are there")
    assert done.stderr.startswith("bad: ")
    assert "nearly there" in done.stderr
    done = gem_terminal("build", "tasks", "--task", "good", cwd=tmp_path, **environment(backend, "test-build"))
    assert done.returncode == 0


@each_backend
def test_check_tells_sound_tasks_from_others(backend: str, tmp_path: Path) -> None:
    """A task that passes untouched, and one whose solution fails, are named."""
    write_task(tmp_path / "tasks" / "easy", test="true")
    write_task(tmp_path / "tasks" / "good")
    write_task(tmp_path / "tasks" / "wrong", test="echo seen $(cat /app/note); false")
    done = gem_terminal("check", "tasks", cwd=tmp_path, **environment(backend, "test-check"))
    assert done.returncode == 1
    rows = {line.split()[0]: line for line in done.stdout.splitlines()[1:]}
    assert rows["easy"].endswith("doing nothing passes")
    assert rows["good"].endswith("sound")
    assert "the reference solution fails by hand too: the score is 0; the tests ended with: seen done" in rows["wrong"]


@each_backend
def test_check_says_what_fails_only_under_judge(backend: str, tmp_path: Path) -> None:
    """With a line of JSON for each task."""
    write_task(tmp_path / "tasks" / "carried")
    far = write_task(tmp_path / "tasks" / "elsewhere", test="grep -q done /tmp/note")
    (far / "solution" / "solve.sh").write_text("echo done >/tmp/note\n")
    write_task(tmp_path / "tasks" / "wrong", test="false")
    words = ("check", "tasks", "--verify-in", "judge", "--json")
    done = gem_terminal(*words, cwd=tmp_path, **environment(backend, "test-check"))
    rows = {row["task"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert (done.returncode, rows["carried"]["sound"]) == (1, True)
    assert rows["elsewhere"]["why"].startswith("the reference solution fails only under judge: the score is 0")
    assert rows["wrong"]["why"].startswith("the reference solution fails by hand too: the score is 0")


@pytest.mark.skipif(bool(why_not("docker")), reason=why_not("docker") or "there")
def test_interrupted_check_ends_without_waiting_for_tests(tmp_path: Path) -> None:
    """Ctrl-C removes the machines, so that what runs in them comes to its end."""
    run = f"test-interrupt-{os.getpid()}"
    folder = write_task(tmp_path / "slow", test="sleep 1000")
    (folder / "task.toml").write_text("[verifier]\ntimeout_sec = 900\n")
    words = [sys.executable, "-m", "gem_core", "terminal", "check", "slow"]
    variables = environment("docker", run)
    with subprocess.Popen(words, cwd=tmp_path, env=variables, stderr=subprocess.PIPE, text=True) as program:
        until = time.monotonic() + 200
        while not any(what.startswith("container") for what in left(run)) and time.monotonic() < until:
            assert program.poll() is None
            time.sleep(0.1)
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=200)
    assert (program.returncode, errors.split()) == (130, ["gem:", "interrupted"])
    assert [what for what in left(run) if not what.startswith("image")] == []


@each_backend
def test_clean_says_that_there_was_nothing(backend: str, tmp_path: Path) -> None:
    """Twice, since what others have left may be there at first."""
    variables = environment(backend, "test-clean")
    assert gem_terminal("clean", "--backend", backend, cwd=tmp_path, **variables).returncode == 0
    assert gem_terminal("clean", "--backend", backend, cwd=tmp_path, **variables).returncode == 0


@each_backend
def test_shell_is_a_terminal_with_an_exit_code(backend: str, tmp_path: Path) -> None:
    """A person types into it; its size is the window's."""
    import pty

    write_task(tmp_path / "one")
    words = [sys.executable, "-m", "gem_core", "terminal", "shell", "one"]
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execvpe(words[0], words, environment(backend, "test-shell"))
    seen = b""
    typed = [(b"Write 'done'", b""), (b"# ", b"echo $((6*7))-`stty size`; cat /proc/1/comm; exit 5\r")]
    try:
        while True:
            part = os.read(terminal, 65_536)
            seen += part
            if typed and typed[0][0] in seen:
                os.write(terminal, typed.pop(0)[1])
    except OSError:  # its end
        pass
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    os.close(terminal)
    assert status == 5, seen
    assert b"42-" in seen
