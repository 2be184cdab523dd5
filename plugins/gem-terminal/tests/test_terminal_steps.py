"""What ``TerminalEnv`` makes of tasks of several steps, on a backend, shell and verifier in memory."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from memory_backend import plain_task
from scripted import HALF, PASSED, Script, make

from gem_terminal import episode
from gem_terminal.errors import MachineError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Step, Task


def steps_task(rule: Any = "mean", **fields: Any) -> Task:
    """Return a task of three steps."""
    first = plain_task("long").steps[0]
    steps = tuple(
        replace(first, name=name, instruction=f"Do {name}.", **fields) for name in ("first", "second", "third")
    )
    return replace(plain_task("long"), steps=steps, reward_of_steps=rule)


def test_each_step_is_made_ready_before_its_shell_is_opened(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """With the files and the command of the step; one that fails is no failure of the agent's."""
    staged: list[tuple[str, int]] = []

    def stage(_: Any, step: Step) -> None:
        staged.append((step.name, len(script.shells)))
        if step.name == "third":
            raise MachineError("the command 'make' before the step 'third' took too long")

    monkeypatch.setattr(episode, "stage", stage)
    env = make(monkeypatch, script, [steps_task()])
    env.reset(seed=1)
    env.step("<finish/>")
    *_, reward, terminated, truncated, info = env.step("<finish/>")
    assert staged == [("first", 0), ("second", 1), ("third", 2)]
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["message"] == "the command 'make' before the step 'third' took too long"
    env.close()


def test_steps_of_a_task_follow_each_other(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """Each is judged when the agent finishes it; the return is the mean."""
    script.verdicts = [PASSED, HALF, PASSED]
    env = make(monkeypatch, script, [steps_task(agent_user="worker")], reward="fraction")
    observation, _ = env.reset(seed=1)
    assert observation.startswith("Step 1 of 3.\n\nDo first.")
    observation, first, terminated, _, info = env.step("<finish/>")
    assert observation.startswith("The tests have passed.\n\nStep 2 of 3.\n\nDo second.")
    assert "You have 49 turns and " in observation
    assert terminated is False
    assert info["terminal"]["next_step"] == "second"
    second = env.step("<finish/>")[1]
    _, third, terminated, _, info = env.step("<finish/>")
    assert (first, second, third) == pytest.approx((1 / 3, 0.5 / 3, 1 / 3))
    assert terminated
    assert info["correct"] is False
    assert [options["user"] for options in script.shells] == ["worker"] * 3
    assert script.closed == 3
    env.close()


def test_final_step_alone_counts_where_the_task_says_so(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """Those before bring nothing, and take nothing."""
    script.verdicts = [HALF, HALF, PASSED]
    env = make(monkeypatch, script, [steps_task("final")])
    env.reset(seed=1)
    assert [env.step("<finish/>")[1] for _ in range(2)] == [0.0, 0.0]
    _, reward, _, _, info = env.step("<finish/>")
    assert (reward, info["correct"]) == (1.0, True)
    env.close()


def test_step_below_its_least_reward_ends_the_task(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """The steps that were not reached count as 0."""
    script.verdicts = [HALF]
    env = make(monkeypatch, script, [steps_task(min_reward=0.75)], reward="fraction")
    env.reset(seed=1)
    _, reward, terminated, _, info = env.step("<finish/>")
    assert reward == pytest.approx(0.5 / 3)
    assert (terminated, info["correct"]) == (True, False)
    env.close()
