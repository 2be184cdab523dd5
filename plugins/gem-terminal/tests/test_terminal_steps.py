"""What ``TerminalEnv`` makes of tasks of several steps, on a backend, shell and verifier in memory."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from memory_backend import plain_task
from scripted import HALF, PASSED, Script

from gem_terminal import episode
from gem_terminal.errors import MachineError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Step, Task


def steps_task(rule: Any = "mean", **fields: Any) -> Task:
    """Return a task of three steps."""
    first = plain_task("long").steps[0]
    names = ("first", "second", "third")
    steps = tuple(replace(first, name=name, instruction=f"Do {name}.", **fields) for name in names)
    return replace(plain_task("long"), steps=steps, reward_of_steps=rule)


def test_each_step_is_made_ready_before_its_shell_is_opened(
    make: Any, monkeypatch: pytest.MonkeyPatch, script: Script
) -> None:
    """With the files and the command of the step; one that fails is no failure of the agent's."""
    staged: list[tuple[str, int]] = []

    def stage(_: Any, step: Step) -> None:
        staged.append((step.name, len(script.shells)))
        if step.name == "third":
            raise MachineError("the command 'make' before the step 'third' took too long")

    monkeypatch.setattr(episode, "stage", stage)
    env = make(steps_task())
    env.reset(seed=1)
    env.step("<finish/>")
    *_, reward, terminated, truncated, info = env.step("<finish/>")
    assert staged == [("first", 0), ("second", 1), ("third", 2)]
    assert (reward, terminated, truncated, "'make'" in info["error"]["message"]) == (0.0, False, True, True)


def test_steps_of_a_task_follow_each_other(make: Any, script: Script) -> None:
    """Each is judged when the agent finishes it; the return is the mean."""
    script.verdicts = [PASSED, HALF, PASSED]
    env = make(steps_task(agent_user="worker"), reward="fraction")
    observation, _ = env.reset(seed=1)
    assert observation.startswith("Step 1 of 3.\n\nDo first.")
    observation, first, terminated, _, info = env.step("<finish/>")
    assert observation.startswith("The tests have passed.\n\nStep 2 of 3.\n\nDo second.")
    assert "You have 49 turns and " in observation
    assert (terminated, info["terminal"]["next_step"]) == (False, "second")
    observation, second, *_ = env.step("<finish/>")
    assert observation.startswith("1 of 2 tests have passed.")
    _, third, terminated, _, info = env.step("<finish/>")
    assert (first, second, third) == pytest.approx((1 / 3, 0.5 / 3, 1 / 3))
    assert (terminated, info["correct"]) == (True, False)
    assert [options["user"] for options in script.shells] == ["worker"] * 3
    assert script.closed == 3


@pytest.mark.parametrize(
    ("task", "verdicts", "rewards", "correct"),
    [
        (steps_task("final"), [HALF, HALF, PASSED], [0.0, 0.0, 1.0], True),
        (steps_task(min_reward=0.75), [HALF], [0.5 / 3], False),
    ],
    ids=["the final step alone counts", "a step below its least reward ends the task"],
)
def test_rules_of_steps(make: Any, script: Script, task: Task, verdicts: Any, rewards: Any, correct: bool) -> None:
    script.verdicts = verdicts
    env = make(task, reward="fraction")
    env.reset(seed=1)
    steps = [env.step("<finish/>") for _ in rewards]
    assert [reward for _, reward, *_ in steps] == pytest.approx(rewards)
    assert (steps[-1][2], steps[-1][4]["correct"]) == (True, correct)
