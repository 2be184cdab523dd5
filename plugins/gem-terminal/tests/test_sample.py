"""The tasks of terminal:Sample, as files: both formats, and what runs their checks."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from sample_tasks import build

DATA = Path(__file__).resolve().parent.parent / "gem_terminal" / "data" / "sample"
SOURCES = build.sources()
each_task = pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)


def run_checks(folder: Path, checks: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run checks as a verifier does, in a folder of their own."""
    for name, content in build.below(build.SHARED).items():
        (folder / name).write_bytes(content)
    (folder / "checks.py").write_text(checks, encoding="utf-8")
    command = [sys.executable, "-ISB", str(folder / "runner.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder)


def test_data_is_what_the_sources_make():
    """``python scripts/terminal_sample.py`` was run after the last change."""
    written = build.below(DATA)
    made = build.all_files()
    assert sorted(written) == sorted(made)
    assert [name for name in made if written[name] != made[name]] == []


def test_there_are_tasks_of_every_kind():
    """At least twelve, easy to hard, of the kinds that are asked for."""
    assert len(SOURCES) >= 12
    assert {source.about["difficulty"] for source in SOURCES} == {"easy", "medium", "hard"}
    kinds = {"files", "text-processing", "permissions", "processes", "git", "servers", "scheduling", "archives"}
    assert kinds | {"scripting", "databases"} <= {source.about["category"] for source in SOURCES}


@each_task
def test_wrong_solutions_name_the_checks_that_catch_them(source: build.Source):
    """There are two at least, and the checks they name exist."""
    checks = re.findall(r"^def (test_\w+)", (source.folder / "checks.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(source.wrong()) >= 2
    for path in source.wrong().values():
        named = build.caught_by(path)
        assert named
        assert named <= set(checks)


@each_task
def test_both_formats_ask_the_same(source: build.Source):
    """Their own readers find one instruction, one image and one set of checks in both."""
    bench = DATA / "terminal-bench" / source.name
    harbor = DATA / "harbor" / source.name
    task = yaml.safe_load((bench / "task.yaml").read_text(encoding="utf-8"))
    about = tomllib.loads((harbor / "task.toml").read_text(encoding="utf-8"))
    assert task["instruction"] + "\n" == (harbor / "instruction.md").read_text(encoding="utf-8")
    for key in ("difficulty", "category", "tags"):
        assert task[key] == about["metadata"][key] == source.about[key]
    assert task["max_agent_timeout_sec"] == about["agent"]["timeout_sec"]
    assert task["max_test_timeout_sec"] == about["verifier"]["timeout_sec"]
    assert (bench / "Dockerfile").read_bytes() == (harbor / "environment" / "Dockerfile").read_bytes()
    assert (bench / "tests" / "checks.py").read_bytes() == (harbor / "tests" / "checks.py").read_bytes()
    assert (bench / "solution.sh").read_bytes() == (harbor / "solution" / "solve.sh").read_bytes()


@each_task
def test_an_image_holds_nothing_of_the_checks(source: build.Source):
    """What is copied into the image are files of the task alone, which are in ``files/`` or ``setup/``."""
    dockerfile = (source.folder / "environment" / "Dockerfile").read_text(encoding="utf-8")
    assert set(re.findall(r"^COPY (\S+) ", dockerfile, re.MULTILINE)) <= {"files/", "setup/"}
    assert {name.partition("/")[0] for name in source.environment()} <= {"Dockerfile", "files", "setup"}
    if "setup/" in dockerfile:
        assert "rm -r /opt/setup" in dockerfile


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
    setup = (build.HERE / "lost-commit" / "environment" / "setup" / "make.py").read_text(encoding="utf-8")
    checks = (build.HERE / "lost-commit" / "checks.py").read_text(encoding="utf-8")
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
