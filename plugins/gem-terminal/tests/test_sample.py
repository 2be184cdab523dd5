"""The tasks of terminal:Sample: two formats of one source, their reference and wrong solutions, and their checks."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from docker_machines import needs_engine

import gem_core
import gem_terminal
from gem_terminal import sample
from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks

DATA = Path(gem_terminal.__file__).parent / "data" / "sample"
WRONG = {
    folder.name: sorted(folder.glob("*.sh")) for folder in sorted(Path(__file__).with_name("wrong_solutions").iterdir())
}
"""The solutions that must fail, ``wrong_solutions/TASK/NAME.sh``: a line ``# fails:`` says by which checks."""
NAMES = list(WRONG)
EACH = ("terminal:Sample", "terminal:Sample-terminal-bench")


def caught_by(wrong: Path) -> set[str]:
    """Return the names of the checks that a wrong solution fails by, as it says itself."""
    lines = wrong.read_text(encoding="utf-8").splitlines()
    return {name for line in lines if line.startswith("# fails: ") for name in line.split()[2:]}


def run_checks(folder: Path, checks: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run checks as a verifier does, in a folder of their own."""
    for name in ("runner.py", "sample_helpers.py"):
        shutil.copy(DATA / "shared" / name, folder)
    (folder / "checks.py").write_text(checks, encoding="utf-8")
    command = [sys.executable, "-ISB", str(folder / "runner.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder)


def test_both_formats_ask_the_same_of_every_kind():
    """Easy to hard; one instruction, time limits, checks, solution and image in both; nothing is passed over."""
    harbor, bench = (find_tasks([sample.sample_folder(form)]).tasks for form in ("harbor", "terminal-bench"))
    assert [task.name for task in harbor] == [task.name for task in bench] == NAMES
    assert {task.difficulty for task in harbor} == {"easy", "medium", "hard"}
    assert len({task.category for task in harbor}) >= 10
    assert [task.notes for task in (*harbor, *bench) if task.notes or task.environment.unsupported] == []
    for one, other in zip(harbor, bench, strict=True):
        (a,), (b,) = one.steps, other.steps
        said = [(step.instruction, step.agent_timeout_s, step.verifier.timeout_s) for step in (a, b)]
        assert said[0] == said[1] == (a.instruction, 600, 120)
        assert (one.category, one.difficulty, one.tags) == (other.category, other.difficulty, other.tags)
        files = {"tests/checks.py": "", "tests/runner.py": "", "tests/sample_helpers.py": ""}
        files |= {"solution/solve.sh": "solution.sh", "environment/Dockerfile": "Dockerfile"}
        setup = [path.name for path in (one.folder / "environment/setup").iterdir()]
        for inside, there in (files | {f"environment/setup/{name}": f"setup/{name}" for name in setup}).items():
            assert (one.folder / inside).read_bytes() == (other.folder / (there or inside)).read_bytes()


def test_folders_are_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In the cache folder; one that cannot be written to is an error that names the variable."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    written = []
    for _ in range(2):
        sample.sample_folder.cache_clear()
        folder = sample.sample_folder("harbor")
        assert folder.parent == tmp_path / "cache" / "gem" / "terminal-sample"
        written.append((folder / "count-errors" / "task.toml").stat().st_mtime_ns)
    assert written[0] == written[1]
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    sample.sample_folder.cache_clear()
    with pytest.raises(TaskError, match="XDG_CACHE_HOME"):
        sample.sample_folder("harbor")
    sample.sample_folder.cache_clear()


@pytest.mark.parametrize("name", NAMES)
def test_wrong_solutions_name_the_checks_that_catch_them(name: str):
    """There are two at least, and the checks they name exist."""
    checks = re.findall(
        r"^def (test_\w+)", (DATA / "tasks" / name / "tests/checks.py").read_text("utf-8"), re.MULTILINE
    )
    assert len(WRONG[name]) >= 2
    for path in WRONG[name]:
        assert set() < caught_by(path) <= set(checks)


CHECKS = """
import os
from sample_helpers import read_bytes, run

def test_b():
    pass

def test_a():
    assert False, 'two\\nlines'

def test_forged():  # what looks like a summary is marked, line by line, and cut
    forged = 'PASSED checks.py::test_a'
    raise ValueError(f'x\\n= short test summary info =\\n{forged}\\r\\u2028{forged}\\n' * 1000)

def test_pipe():  # a pipe, a giant file, and a program that neither ends nor stops writing hold up no check
    os.mkfifo('pipe')
    read_bytes('pipe')

def test_giant():
    with open('giant', 'wb') as file:
        file.truncate(2**40)
    read_bytes('giant')

def test_endless():
    assert run('sleep', '1000', timeout_s=0.2).exit_code is None
    assert len(run('yes', timeout_s=20).out) == 5_000_000
"""


def test_the_runner_reports_every_check(tmp_path: Path):
    """Passed and failed, in their order, as pytest names them; the reward is 0 when one fails, and 1 if none does."""
    done = run_checks(tmp_path, CHECKS, str(tmp_path / "logs"))
    summary = done.stdout[done.stdout.index("= short test summary info =") :]
    found = re.findall(r"^(PASSED|FAILED) checks.py::test_(\w+)", summary, re.MULTILINE)
    expected = {
        "b": "PASSED",
        "a": "FAILED",
        "forged": "FAILED",
        "pipe": "FAILED",
        "giant": "FAILED",
        "endless": "PASSED",
    }
    assert found == [(status, name) for name, status in expected.items()]
    assert "FAILED checks.py::test_a - AssertionError: two lines\n" in summary
    assert len(re.findall("^=+ short test summary info", done.stdout, re.MULTILINE)) == 1
    assert len(done.stdout) < 10_000
    assert (done.returncode, (tmp_path / "logs/reward.txt").read_text()) == (1, "0\n")
    report = (tmp_path / "logs/ctrf.json").read_text()
    assert [report.count(f'"status": "{status}"') for status in ("passed", "failed")] == [2, 4]
    done = run_checks(tmp_path, "def test_a():\n    pass\n", str(tmp_path / "logs"))
    assert (done.returncode, (tmp_path / "logs/reward.txt").read_text()) == (0, "1\n")


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_git_finds_the_lost_commit(tmp_path: Path):
    """The repository that lost-commit makes by hand is one to git: whole, clean, its commits those of the checks."""
    task = DATA / "tasks/lost-commit"
    made = (task / "environment/setup/make.py").read_text("utf-8").replace("/app/project", str(tmp_path / "project"))
    subprocess.run([sys.executable, "-c", made], check=True, timeout=60)

    def git(*words: str) -> str:
        command = ["git", "-c", "safe.directory=*", "-C", str(tmp_path / "project"), *words]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout

    assert git("status", "--porcelain") == ""
    dangling = [line.split()[-1] for line in git("fsck", "--strict").splitlines() if line.startswith("dangling commit")]
    assert len(dangling) == 3
    same = [name for name in dangling if git("log", "-1", "--format=%s", name) == "Export orders as a table\n"]
    later = max(same, key=lambda name: int(git("log", "-1", "--format=%ct", name)))
    checks = (task / "tests/checks.py").read_text("utf-8")
    assert re.findall(r'^(?:LOST|MAIN) = "(\w+)"', checks, re.MULTILINE) == [later, git("rev-parse", "main").strip()]


@pytest.fixture
def finish(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Take actions in a task, and return what its tests say."""
    monkeypatch.setenv("GEM_TERMINAL_RUN", "sample-trials")

    def finish(env_id: str, task: str, *actions: str) -> tuple[float, set[str]]:
        env = gem_core.make(env_id, tasks=task, pool_size=0)
        try:
            env.reset(seed=0)
            for action in actions or (env.gold_action(),):
                env.step(action)
            assert env.gold_action() == "<finish/>"
            _, reward, terminated, _, info = env.step("<finish/>")
        finally:
            env.close()
        assert terminated, info
        return reward, {test["name"] for test in info["verifier"]["tests"] if not test["passed"]}

    return finish


@needs_engine
@pytest.mark.few(2)
@pytest.mark.parametrize("env_id", EACH)
@pytest.mark.parametrize("name", NAMES)
def test_only_the_reference_solution_passes(finish: Any, env_id: str, name: str):
    """Doing nothing fails, and what the task ships as its solution, its gold action, passes."""
    assert finish(env_id, name) == (1.0, set())
    reward, failed = finish(env_id, name, "<bash>true</bash>")
    assert (reward, bool(failed)) == (0.0, True)


@needs_engine
@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_wrong_solutions_fail_by_the_right_checks(finish: Any, name: str):
    """A plausible mistake or a shortcut fails, by exactly the checks that it names."""
    for wrong in WRONG[name]:
        typed = f"<bash>\ncat >/tmp/wrong.sh <<'SCRIPT-ENDS'\n{wrong.read_text()}\nSCRIPT-ENDS\n</bash>"
        found = finish(EACH[NAMES.index(name) % 2], name, typed, "<bash>bash /tmp/wrong.sh; rm /tmp/wrong.sh</bash>")
        assert found == (0.0, caught_by(wrong))
