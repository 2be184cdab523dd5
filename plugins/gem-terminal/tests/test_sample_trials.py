"""The tasks of terminal:Sample, tried: reference solutions pass, wrong ones fail by the checks that catch them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from docker_machines import needs_engine, variables
from sample_trials import NAMES, WRONG, caught_by

import gem_core

EACH = ("terminal:Sample", "terminal:Sample-terminal-bench")
FEW = {"terminal:Sample": "lost-commit", "terminal:Sample-terminal-bench": "runaway-worker"}

pytestmark = needs_engine
each_format = pytest.mark.parametrize("env_id", EACH)


def check(env_id: str, *names: str) -> dict[str, tuple[str, str]]:
    """Return how the reference solution of each task and doing nothing end, by ``gem terminal check``."""
    command = [sys.executable, "-m", "gem_core", "terminal", "check", env_id]
    command += [word for name in names for word in ("--task", name)]
    done = subprocess.run(
        command, env=variables("sample-trials"), capture_output=True, text=True, timeout=550, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    return {name: (solution, nothing) for name, solution, nothing, *_ in rows}


@pytest.mark.few(2)
@each_format
def test_only_the_reference_solution_passes(env_id: str):
    """Doing nothing fails, and what the task ships as its solution passes."""
    assert check(env_id, FEW[env_id]) == {FEW[env_id]: ("passes", "fails")}


@pytest.mark.thorough
@each_format
def test_only_the_reference_solution_of_every_task_passes(env_id: str):
    """The same of all tasks."""
    assert check(env_id) == dict.fromkeys(NAMES, ("passes", "fails"))


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_wrong_solutions_fail_by_the_right_checks(name: str):
    """A plausible mistake or a shortcut fails, by exactly the checks that it names."""
    found = {path.stem: failed_checks(name, path) for path in WRONG[name]}
    assert found == {path.stem: caught_by(path) for path in WRONG[name]}


def failed_checks(name: str, wrong: Path) -> set[str]:
    """Return the checks that fail after a script was run in a machine."""
    env_id = EACH[NAMES.index(name) % 2]
    env = gem_core.make(env_id, tasks=name, pool_size=0)
    try:
        env.reset(seed=0)
        env.step(f"<bash>\ncat >/tmp/wrong.sh <<'SCRIPT-ENDS'\n{wrong.read_text()}\nSCRIPT-ENDS\n</bash>")
        env.step("<bash>bash /tmp/wrong.sh; rm /tmp/wrong.sh</bash>")
        _, reward, terminated, _, info = env.step("<finish/>")
        assert terminated, info
        assert reward == 0
        return {test["name"] for test in info["verifier"]["tests"] if not test["passed"]}
    finally:
        env.close()


@pytest.mark.few(2)
def test_gold_actions_are_the_reference_solution(monkeypatch: pytest.MonkeyPatch):
    """A command that does what the solution does, and then the end."""
    monkeypatch.setenv("GEM_TERMINAL_RUN", "sample-trials")
    env = gem_core.make("terminal:Sample", tasks="lost-commit")
    env.reset(seed=0)
    assert env.step(env.gold_action())[1:4] == (0.0, False, False)
    assert env.gold_action() == "<finish/>"
    _, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert info["verifier"]["tests"]
    assert all(test["passed"] for test in info["verifier"]["tests"])
    env.close()
