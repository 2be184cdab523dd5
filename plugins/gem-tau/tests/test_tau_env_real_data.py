"""The benchmark's own tasks, played through the environment: reference actions get 1, without a write they get 0."""

from __future__ import annotations

import json
from collections.abc import Sequence

import pytest
from tau_folders import REAL

import gem_core as gem
from gem_core import Response
from gem_tau import Action
from gem_tau.env import TauEnv
from gem_tau.prompts import STOP

pytestmark = pytest.mark.skipif(REAL is None, reason="there is no tau_retail in ../shared/data")


@pytest.fixture(scope="module")
def env() -> TauEnv:
    """The tasks of the test split."""
    return TauEnv(REAL, split="test", max_assistant_steps=60)


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


@pytest.mark.parametrize("native", [False, True])
def test_reference_actions_get_the_reward_in_every_task(env: TauEnv, native: bool) -> None:
    """All 115, whether the calls are written or native."""
    assert env.num_tasks == 115
    tasks = env.task_set.tasks
    assert [index for index, task in enumerate(tasks) if played(env, index, task.actions, native=native) != 1.0] == []


def test_folder_must_be_named() -> None:
    """The benchmark's ids need a folder, and take it as an argument."""
    with pytest.raises(gem.errors.MissingRequirementError, match=r"argument: make\(…, folder=…\), or --set folder=…"):
        gem.make("tau:Retail-test")
    assert gem.make("tau:Retail-test", folder=str(REAL)).num_tasks == 115


def test_scripted_user_retells_the_benchmarks_instructions() -> None:
    """In the first person; and leaves once something is done."""

    def assistant(observation: str, context: gem.Context) -> str:
        return ["Shall I proceed?", "It has been done."][context.turn]

    agents = {"assistant": assistant, "user": "tau-user:patient"}
    env = gem.make("tau:Retail-test", folder=str(REAL))
    (joint,) = gem.rollout(env, agents=agents, episodes=1)
    opening, agreed, last = [turn.action for turn in joint.seats["user"].transitions]
    assert opening.startswith("I am Yusuf Rossi in 19122. I received my order #W2378156 and wish to exchange")
    assert (agreed, last) == ("Yes, please go ahead.", STOP)
