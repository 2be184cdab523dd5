"""``gem tau check``: what it prints, as lines and as JSON, and its exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from click.testing import CliRunner, Result
from tau_folders import CANCEL, HOME, MOVE, tau2_task, tau_task, write_tau, write_tau2

from gem_tau.command import command

BACK = {"name": "modify_user_address", "kwargs": {"user_id": "ann_lee_1", **HOME}}
AGAIN = {"name": "modify_pending_order_address", "kwargs": {"order_id": "#W1", **HOME}}


def check(*words: str | Path) -> Result:
    """Run the command in this process."""
    return CliRunner().invoke(command, ["check", *map(str, words)], catch_exceptions=False)


OURS = "The assistant reads the tools' descriptions of gem-tau"


def test_reference_actions_get_1(tmp_path: Path) -> None:
    """And the exit code is 0."""
    done = check(write_tau(tmp_path, tau_task(CANCEL), tau_task(outputs=("red",))))
    assert done.exit_code == 0
    assert done.output == f"2 of 2 tasks get reward 1 by their reference actions\n{OURS}\n"


def test_without_one_write_they_do_not(tmp_path: Path) -> None:
    """Writes that make no difference to the final database are told apart, with the reason."""
    write_tau(tmp_path, tau_task(CANCEL, CANCEL), tau_task(MOVE, BACK, MOVE, AGAIN))
    done = check(tmp_path, "--drop-one-write")
    assert done.exit_code == 0
    assert done.output.splitlines() == [
        "2 of 2 tasks get reward 1 by their reference actions",
        "0 of 1 still do with one write left out",
        "5 more writes make no difference to the final database, so that no reward can see them:",
        "  test-0, action 0, cancel_pending_order: the other actions lead there too",
        "  test-0, action 1, cancel_pending_order: Error: non-pending order cannot be cancelled",
        "  test-1, action 0, modify_user_address: the other actions lead there too",
        "  test-1, action 1, modify_user_address: the other actions lead there too",
        "  test-1, action 3, modify_pending_order_address: nothing is new in it",
        OURS,
    ]


def test_a_task_that_its_own_actions_do_not_solve(tmp_path: Path) -> None:
    """It is named, and the exit code is 1."""
    done = check(write_tau(tmp_path, tau_task(CANCEL, outputs=("1,234",))))
    assert (done.exit_code, done.output.splitlines()[1]) == (1, "  test-0 does not")


def test_a_reward_that_does_not_see_a_write(tmp_path: Path) -> None:
    """As where the basis of a task leaves the database out."""
    done = check(write_tau2(tmp_path, tau2_task("a", MOVE, reward_basis=["COMMUNICATE"])), "--drop-one-write")
    assert done.exit_code == 1
    assert done.output.splitlines()[1:] == [
        "1 of 1 still do with one write left out",
        "  a without action 0, modify_user_address",
        OURS,
    ]


def test_a_line_of_json_for_each_task(tmp_path: Path) -> None:
    """With the hash of its final database; tasks that are left out are there with the reason."""
    judged = tau2_task("b", nl_assertions=["It is polite."], reward_basis=["NL_ASSERTION"])
    done = check(write_tau2(tmp_path, tau2_task("a", MOVE), judged), "--drop-one-write", "--json")
    first, second = map(json.loads, done.output.splitlines())
    write = {"position": 0, "name": "modify_user_address", "effect": "final", "error": "", "reward": 0.0}
    assert len(first.pop("hash")) == 64
    assert first == {"task": "a", "reward": 1.0, "dropped": [write]}
    assert second == {"task": "b", "left_out": "a model would have to judge it (nl_assertions)"}


def test_a_folder_that_is_not_there_is_one_line_on_standard_error(tmp_path: Path) -> None:
    """Through the installed command."""
    line = [sys.executable, "-m", "gem_core", "tau", "check", "nowhere"]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("gem: there is no folder nowhere; a folder of tau-bench's retail has orders.json")
    assert done.stderr.count("\n") == 1
