"""The benchmark's own tasks, played through the environment: reference actions get 1, without a write they get 0."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

import gem_core as gem
from gem_core import Response
from gem_tau import Action, TaskSet, replay
from gem_tau.env import TauEnv
from gem_tau.prompts import STOP

FOLDER = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "tau_retail"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="there is no ../shared/data/tau_retail")


@pytest.fixture(scope="module")
def env() -> TauEnv:
    """The tasks of the test split."""
    return TauEnv(FOLDER, split="test", max_assistant_steps=60)


def played(env: TauEnv, index: int, actions: Sequence[Action], *, native: bool = False) -> float:
    """Return the reward of calling tools, telling the outputs, and the user stopping."""
    env.reset(seed=0, options={"index": index})
    env.step({"user": "Hello."})
    for action in actions:
        call = {"name": action.name, "arguments": action.arguments}
        response = f"<tool_call>{json.dumps(call)}</tool_call>"
        if native:
            function = {"name": action.name, "arguments": json.dumps(action.arguments)}
            response = Response("", tool_calls=[{"id": "1", "function": function}])
        env.step({"assistant": response})
        if not env.agents:  # it handed over
            return env.cumulative["assistant"]
    env.step({"assistant": f"That is done. {' and '.join(env.task.outputs)}"})
    return env.step({"user": STOP})[1]["assistant"]


def without_a_write(task_set: TaskSet, actions: Sequence[Action]) -> Iterator[list[Action]]:
    """Yield the actions without each write on which the final database depends."""
    reference = task_set.digest(replay(task_set, actions))
    for position, action in enumerate(actions):
        rest = [*actions[:position], *actions[position + 1 :]]
        if action.name in task_set.domain.writes and task_set.digest(replay(task_set, rest)) != reference:
            yield rest


@pytest.mark.parametrize("native", [False, True])
def test_reference_actions_get_the_reward_in_every_task(env: TauEnv, native: bool) -> None:
    """All 115, whether the calls are written or native."""
    assert env.num_tasks == 115
    tasks = env.task_set.tasks
    assert [index for index, task in enumerate(tasks) if played(env, index, task.actions, native=native) != 1.0] == []


@pytest.mark.parametrize(
    "indices", [range(0, 115, 12), pytest.param(range(115), marks=pytest.mark.thorough)], ids=["some", "all"]
)
def test_a_write_that_is_left_out_costs_the_reward(env: TauEnv, indices: range) -> None:
    """In each of the tasks, and for each write."""
    for index in indices:
        for actions in without_a_write(env.task_set, env.task_set.tasks[index].actions):
            assert played(env, index, actions) == 0.0


def test_an_output_that_is_not_told_costs_the_reward(env: TauEnv) -> None:
    """The database alone is not enough where the task asks for an answer."""
    index = next(index for index, task in enumerate(env.task_set.tasks) if task.outputs)
    env.reset(seed=0, options={"index": index})
    env.step({"user": "Hello."})
    for action in env.task.actions:
        env.step(
            {"assistant": f"<tool_call>{json.dumps({'name': action.name, 'arguments': action.arguments})}</tool_call>"}
        )
    env.step({"assistant": "That is done."})
    assert env.step({"user": STOP})[1]["assistant"] == 0.0


def test_folder_must_be_named() -> None:
    """The benchmark's ids need a folder, and take it as an argument."""
    with pytest.raises(gem.errors.MissingRequirementError, match=r"argument: make\(…, folder=…\), or --set folder=…"):
        gem.make("tau:Retail-test")
    assert gem.make("tau:Retail-test", folder=str(FOLDER)).num_tasks == 115


def test_scripted_user_retells_the_benchmarks_instructions() -> None:
    """In the first person; and leaves once something is done."""

    def assistant(observation: str, context: gem.Context) -> str:
        return ["Shall I proceed?", "It has been done."][context.turn]

    agents = {"assistant": assistant, "user": "tau-user:patient"}
    env = gem.make("tau:Retail-test", folder=str(FOLDER))
    (joint,) = gem.rollout(env, agents=agents, episodes=1)
    opening, agreed, last = [turn.action for turn in joint.seats["user"].transitions]
    assert opening.startswith("I am Yusuf Rossi in 19122. I received my order #W2378156 and wish to exchange")
    assert (agreed, last) == ("Yes, please go ahead.", STOP)
