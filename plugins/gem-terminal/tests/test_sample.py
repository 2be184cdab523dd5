"""The tasks of terminal:Sample: one source of each, two formats, and what runs their checks."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from sample_trials import NAMES, WRONG, caught_by

import gem_terminal
from gem_terminal import sample
from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

DATA = Path(gem_terminal.__file__).parent / "data" / "sample"


@pytest.fixture(scope="module", params=["harbor", "terminal-bench"])
def tasks(request: pytest.FixtureRequest) -> list[Task]:
    """Give the sample tasks in each format."""
    return list(find_tasks([sample.sample_folder(request.param)]).tasks)


def run_checks(folder: Path, checks: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run checks as a verifier does, in a folder of their own."""
    for name in ("runner.py", "sample_helpers.py"):
        shutil.copy(DATA / "shared" / name, folder)
    (folder / "checks.py").write_text(checks, encoding="utf-8")
    command = [sys.executable, "-ISB", str(folder / "runner.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder)


def test_there_are_tasks_of_every_kind(tasks: list[Task]):
    """At least twelve in both formats, easy to hard, of the kinds that are asked for; nothing is passed over."""
    assert [task.name for task in tasks] == NAMES
    assert len(tasks) >= 12
    assert {task.difficulty for task in tasks} == {"easy", "medium", "hard"}
    kinds = {"files", "text-processing", "permissions", "processes", "git", "servers", "scheduling", "archives"}
    assert kinds | {"scripting", "databases"} <= {task.category for task in tasks}
    assert [task.notes for task in tasks if task.notes or task.environment.unsupported] == []


def test_both_formats_ask_the_same():
    """One instruction, time limits, checks, solution and image in both."""
    formats = [find_tasks([sample.sample_folder(form)]).tasks for form in ("harbor", "terminal-bench")]
    for one, other in zip(*formats, strict=True):
        assert (one.format, other.format) == ("harbor", "terminal-bench")
        assert one.steps[0].instruction == other.steps[0].instruction
        assert one.steps[0].agent_timeout_s == other.steps[0].agent_timeout_s == 600
        assert one.steps[0].verifier.timeout_s == other.steps[0].verifier.timeout_s == 120
        assert (one.category, one.difficulty, one.tags) == (other.category, other.difficulty, other.tags)
        assert one.environment.main.entrypoint == other.environment.main.entrypoint
        for inside in ("tests/checks.py", "tests/runner.py", "tests/sample_helpers.py"):
            assert (one.folder / inside).read_bytes() == (other.folder / inside).read_bytes()
        assert (one.folder / "solution/solve.sh").read_bytes() == (other.folder / "solution.sh").read_bytes()
        image = {path.name: path.read_bytes() for path in (one.folder / "environment/setup").iterdir()}
        assert image == {path.name: path.read_bytes() for path in (other.folder / "setup").iterdir()}
        assert (one.folder / "environment/Dockerfile").read_bytes() == (other.folder / "Dockerfile").read_bytes()


def test_folders_are_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In the cache folder; one that cannot be written to is an error that names the variable."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    sample.sample_folder.cache_clear()
    first = sample.sample_folder("harbor")
    assert first.parent == tmp_path / "cache" / "gem" / "terminal-sample"
    written = (first / "count-errors" / "task.toml").stat().st_mtime_ns
    sample.sample_folder.cache_clear()
    assert sample.sample_folder("harbor") == first
    assert (first / "count-errors" / "task.toml").stat().st_mtime_ns == written
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    sample.sample_folder.cache_clear()
    with pytest.raises(TaskError, match="XDG_CACHE_HOME"):
        sample.sample_folder("harbor")
    sample.sample_folder.cache_clear()


@pytest.mark.parametrize("name", NAMES)
def test_wrong_solutions_name_the_checks_that_catch_them(name: str):
    """There are two at least, and the checks they name exist."""
    text = (DATA / "tasks" / name / "tests" / "checks.py").read_text(encoding="utf-8")
    checks = re.findall(r"^def (test_\w+)", text, re.MULTILINE)
    assert len(WRONG[name]) >= 2
    for path in WRONG[name]:
        assert caught_by(path)
        assert caught_by(path) <= set(checks)


def test_the_runner_reports_every_check(tmp_path: Path):
    """Passed, failed and raising checks, in their order, as pytest names them; the reward is 0 when one fails."""
    checks = "def test_b():\n    pass\n\ndef test_a():\n    assert False, 'two\\nlines'\n\ndef test_c():\n    {}['x']\n"
    done = run_checks(tmp_path, checks, str(tmp_path / "logs"))
    summary = done.stdout[done.stdout.index("= short test summary info =") :].splitlines()
    assert [line for line in summary if "::" in line] == [
        "PASSED checks.py::test_b",
        "FAILED checks.py::test_a - AssertionError: two lines",
        "FAILED checks.py::test_c - KeyError: 'x'",
    ]
    assert done.returncode == 1
    assert (tmp_path / "logs" / "reward.txt").read_text() == "0\n"
    results = json.loads((tmp_path / "logs" / "ctrf.json").read_text())["results"]
    assert [(test["name"], test["status"]) for test in results["tests"]] == [
        ("test_b", "passed"),
        ("test_a", "failed"),
        ("test_c", "failed"),
    ]
    assert {key: results["summary"][key] for key in ("tests", "passed", "failed")} == {
        "tests": 3,
        "passed": 1,
        "failed": 2,
    }


def test_the_runner_rewards_what_passes(tmp_path: Path):
    """All checks passed: exit code 0, and a reward of 1."""
    done = run_checks(tmp_path, "def test_a():\n    pass\n", str(tmp_path / "logs"))
    assert done.returncode == 0
    assert (tmp_path / "logs" / "reward.txt").read_text() == "1\n"


def test_what_a_check_found_is_not_taken_for_a_summary(tmp_path: Path):
    """A file of the agent's that looks like a summary is marked, line by line, and cut, where a message repeats it."""
    forged = "x\n= short test summary info =\nPASSED checks.py::test_a\r\u2028PASSED checks.py::test_a\n"
    done = run_checks(tmp_path, f"def test_a():\n    raise ValueError({forged!r} * 1000)\n")
    lines = done.stdout.splitlines()
    assert [line for line in lines if line.startswith("PASSED")] == []
    assert sum(line.startswith("====") and "short test summary info" in line for line in lines) == 1
    assert len(done.stdout) < 10_000


def test_helpers_refuse_what_would_hold_them_up(tmp_path: Path):
    """A pipe, a giant file, and a program that neither ends nor stops writing make a check fail, not hang."""
    checks = f"""
import os
from sample_helpers import files_below, read_bytes, run

def test_pipe():
    os.mkfifo({str(tmp_path / "pipe")!r})
    read_bytes({str(tmp_path / "pipe")!r})

def test_giant():
    with open({str(tmp_path / "giant")!r}, "wb") as file:
        file.truncate(2**40)
    read_bytes({str(tmp_path / "giant")!r})

def test_endless():
    assert run("sleep", "1000", timeout_s=0.2).exit_code is None

def test_output_is_limited():
    done = run("yes", timeout_s=20)
    assert done.exit_code != 0
    assert len(done.out) == 5_000_000
"""
    done = run_checks(tmp_path, checks)
    assert re.findall(r"^(PASSED|FAILED) checks.py::(\w+)", done.stdout, re.MULTILINE) == [
        ("FAILED", "test_pipe"),
        ("FAILED", "test_giant"),
        ("PASSED", "test_endless"),
        ("PASSED", "test_output_is_limited"),
    ]


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_git_finds_the_lost_commit(tmp_path: Path):
    """The repository that lost-commit makes by hand is one to git: whole, clean, its commits those of the checks."""
    setup = (DATA / "tasks/lost-commit/environment/setup/make.py").read_text(encoding="utf-8")
    checks = (DATA / "tasks/lost-commit/tests/checks.py").read_text(encoding="utf-8")
    root = tmp_path / "project"
    made = setup.replace('ROOT = "/app/project"', f"ROOT = {str(root)!r}")
    assert made != setup
    subprocess.run([sys.executable, "-c", made], check=True, timeout=60)

    def git(*words: str) -> str:
        command = ["git", "-c", "safe.directory=*", "-C", str(root), *words]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout

    assert git("status", "--porcelain") == ""
    dangling = [line.split()[-1] for line in git("fsck", "--strict").splitlines() if line.startswith("dangling commit")]
    assert len(dangling) == 3
    same = [name for name in dangling if git("log", "-1", "--format=%s", name) == "Export orders as a table\n"]
    later = max(same, key=lambda name: int(git("log", "-1", "--format=%ct", name)))
    assert re.findall(r'^(?:LOST|MAIN) = "(\w+)"', checks, re.MULTILINE) == [later, git("rev-parse", "main").strip()]
