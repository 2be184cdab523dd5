"""``TauEnv``: turns of assistant and user, calls in all forms, what neither sees of the other, and how it ends."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tau_folders import write_tau

import gem_core as gem
from gem_core import Response
from gem_core.errors import ArgumentError, DatasetError
from gem_core.rollouts import load_agent
from gem_core.testing import check_env, check_plugin
from gem_tau.env import TauEnv
from gem_tau.prompts import GREETING, STOP

if TYPE_CHECKING:
    from pathlib import Path

CANCEL = ("cancel_order", {"order_id": "#1042", "reason": "ordered by mistake"})
"""The reference action of the first task of the sample."""
LOOK = ("get_order", {"order_id": "#1042"})
OTHER = ("change_address", {"order_id": "#1024", "address": "x"})


def written(name: str, arguments: dict[str, Any]) -> str:
    """Return a call as text."""
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


def native(*calls: tuple[str, dict[str, Any]], text: str = "") -> Response:
    """Return native calls, whose ids are the letters from a."""
    functions = [{"name": name, "arguments": json.dumps(arguments)} for name, arguments in calls]
    return Response(text, tool_calls=[{"id": chr(97 + at), "function": each} for at, each in enumerate(functions)])


class Talk:
    """The sample in one of its tasks, after the user's first words; its methods return what a step gives.

    Args:
        index: The task.
        env: Another environment than the sample as it is registered.
    """

    def __init__(self, index: int = 0, env: Any = None, **options: Any) -> None:
        self.env = env or gem.make("tau:Sample", **options)
        self.env.reset(seed=0, options={"index": index})
        self.user("I want to cancel order #1042.")

    def user(self, words: str) -> Any:
        """Have the user say something."""
        return self.env.step({"user": words})

    def assistant(self, words: str) -> Any:
        """Have the assistant say or call something."""
        return self.env.step({"assistant": words})

    def end(self, words: str = "It is done.", last_words: str = STOP) -> Any:
        """Have the assistant say something, and the user stop."""
        self.assistant(words)
        return self.user(last_words)


def test_user_opens_and_the_policy_and_tools_come_first() -> None:
    """The user answers a greeting, whose stop ends nothing; the assistant's first info has the policy and schemas."""
    env = gem.make("tau:Sample")
    observations, infos = env.reset(seed=0, options={"index": 0})
    assert observations == {"user": GREETING}
    assert "You are Ines Castro." in infos["user"]["system"]
    assert infos["user"]["task_id"] == "sample-0"
    observations, rewards, *_, infos = env.step({"user": f"<think>They are slow.</think>{STOP}"})
    assert (observations, rewards) == ({"assistant": STOP}, {"assistant": 0.0})
    assert infos["assistant"]["system"].startswith("# Policy of Spoke & Bell")
    assert [tool["function"]["name"] for tool in infos["assistant"]["tools"]][:2] == ["cancel_order", "change_address"]
    drawn = [env.reset(seed=seed)[1]["user"]["task_id"] for seed in range(20)]
    assert drawn == [env.reset(seed=seed)[1]["user"]["task_id"] for seed in range(20)]
    assert len(set(drawn)) > 4


def test_calls_are_answered_and_words_are_said() -> None:
    """After a call the assistant acts again; what it says without one is shown to the user, without thinking."""
    talk = Talk()
    observations, _, _, _, infos = talk.assistant("Wait. " + written(*LOOK))
    assert observations["assistant"].startswith('Output of get_order:\n{"order_id": "#1042", "customer_id": "ines"')
    assert infos["assistant"]["tool"] == {"name": LOOK[0], "arguments": LOOK[1], "failed": False, "error": None}
    assert infos["assistant"]["parsed_action"].endswith("</tool_call>")
    assert talk.assistant("<think>It is hers.</think>Shall I cancel it?")[0] == {"user": "Shall I cancel it?"}
    assert talk.user("")[0] == {"assistant": "(nothing was said)"}


@pytest.mark.parametrize(
    ("calls", "last_words", "reward"),
    [
        ([CANCEL], STOP, 1.0),
        ([CANCEL], f"Thank you. {STOP}", 1.0),
        ([], STOP, 0.0),
        ([CANCEL, OTHER], STOP, 0.0),
    ],
)
def test_database_decides_the_reward(calls: list[Any], last_words: str, reward: float) -> None:
    """The user's stop word ends the episode, and the assistant is rewarded for the database that it leaves."""
    talk = Talk()
    for call in calls:
        talk.assistant(written(*call))
    observations, rewards, terminations, truncations, infos = talk.end(last_words=last_words)
    assert (observations, rewards) == ({}, {"assistant": reward, "user": 0.0})
    assert (terminations, any(truncations.values())) == ({"assistant": True, "user": True}, False)
    assert infos["assistant"]["correct"] == bool(reward)
    assert infos["assistant"]["tau"] == {"DB": reward, "COMMUNICATE": 1.0}
    assert "correct" not in infos["user"]


@pytest.mark.parametrize(
    ("words", "reward"), [("It comes to 98.40.", 1.0), ("<think>98.4</think>Hello.", 0.0), ("`98.4`", 1.0)]
)
def test_outputs_must_be_said(words: str, reward: float) -> None:
    """What a task asks to tell counts where it was said to the user, not where it was thought."""
    _, rewards, *_, infos = Talk(4).end(words)
    assert rewards["assistant"] == reward
    assert infos["assistant"]["tau"] == {"DB": 1.0, "COMMUNICATE": reward}


def test_first_native_call_alone_is_executed() -> None:
    """Results come back under the ids of the calls, and further calls of a response are not executed."""
    talk = Talk()
    first, second = talk.assistant(native(CANCEL, OTHER, text="Done!"))[4]["assistant"]["messages"]
    assert (first["role"], first["tool_call_id"], second["tool_call_id"]) == ("tool", "a", "b")
    assert json.loads(first["content"])["status"] == "cancelled"
    assert second["content"].startswith("Not executed")
    assert talk.end()[1]["assistant"] == 1.0


@pytest.mark.parametrize(
    ("response", "told"),
    [
        ('<tool_call>{"name": "cancel_order"', "The call could not be read: "),
        (native(("cancel", {})), "The call could not be read: no tool 'cancel'. Did you mean 'cancel_order'?"),
        (native(("get_order", {})), "Output of get_order:\nError: "),
        (native(("get_order", {"order_id": {"a": [1]}})), "Output of get_order:\nError: "),
        (native(("cancel_order", {"order_id": "#1042", "reason": "bored"})), "Output of cancel_order:\nError: "),
    ],
)
def test_failed_calls_are_told_to_the_assistant_alone(response: str, told: str) -> None:
    """It acts again, and the user hears nothing."""
    observations, *_, infos = Talk().assistant(response)
    assert observations["assistant"].startswith(told)
    assert infos["assistant"]["tool"]["failed"]


def test_handing_over_ends_the_episode() -> None:
    """The tool that hands over ends it at once; the reward is computed all the same."""
    talk = Talk()
    talk.assistant(written(*CANCEL))
    observations, rewards, terminations, _, infos = talk.assistant(written("hand_over", {"summary": "x"}))
    assert (observations, rewards) == ({}, {"assistant": 1.0, "user": 0.0})
    assert all(terminations.values())
    assert infos["assistant"]["final_obs"] == "Output of hand_over:\nA human takes over."
    assert infos["user"]["final_obs"] == gem.TERMINAL_STATE


def test_assistant_is_cut_off_after_its_last_step() -> None:
    """After ``max_assistant_steps`` both are truncated without a reward, but the user may still end the episode."""
    talk = Talk(max_assistant_steps=2)
    talk.assistant(written(*LOOK))
    _, rewards, terminations, truncations, infos = talk.assistant(written(*LOOK))
    assert rewards == {"assistant": 0.0, "user": 0.0}
    assert (terminations["assistant"], truncations) == (False, {"assistant": True, "user": True})
    assert infos["assistant"]["correct"] is False
    for words, reward in (("And now?", 0.0), (STOP, 1.0)):
        talk = Talk(max_assistant_steps=2)
        talk.assistant(written(*CANCEL))
        assert talk.end(last_words=words)[1]["assistant"] == reward
        assert talk.env.agents == []
    for steps in (0, "ten", True):
        with pytest.raises(ArgumentError, match="max_assistant_steps"):
            TauEnv("gem_tau:sample", max_assistant_steps=steps)


def test_user_is_never_judged() -> None:
    """Where an episode is cut off, its success is unknown too, as of one that ends."""
    env = gem.make("tau:Sample", max_assistant_steps=1)
    (joint,) = gem.rollout(env, agents=lambda observation: "Yes?", episodes=1, seed=0)
    assert {episode.seat: episode.success for episode in joint} == {"assistant": False, "user": None}


def test_neither_seat_sees_what_is_the_others() -> None:
    """The instruction and the reference actions stay with the user's seat, calls and results with the assistant's."""
    env = gem.make("tau:Sample")
    for index in range(env.num_tasks):
        observations, infos = env.reset(seed=0, options={"index": index})
        seen: dict[str, list[Any]] = {"assistant": [], "user": []}
        turns = [
            {"user": "<think>MINE</think>Hello."},
            {"assistant": "<think>MINE</think>" + written(*LOOK)},
            {"assistant": native(("get_product", {"product": "bell"}), text="Let me look.")},
            {"assistant": "Hello. <think>MINE"},
            {"user": "MINE</think>" + STOP},
        ]
        for turn in turns:
            for agent, observation in observations.items():
                seen[agent] += [observation, infos[agent]]
            observations, _, _, _, infos = env.step(turn)
        for agent, info in infos.items():
            seen[agent].append({name: value for name, value in info.items() if name != "parsed_action"})
        task = env.unwrapped.task
        assistant, user = json.dumps(seen["assistant"]), json.dumps(seen["user"])
        assert "helmet-red" in assistant  # the result of its call
        for line in task.instruction.splitlines():
            assert json.dumps(line)[1:-1] not in assistant
        assert "actions" not in assistant
        assert not [word for word in ("get_order", "tool_call", "bell-brass", "Let me look", "Policy") if word in user]
        assert "MINE" not in user.replace(json.dumps(task.instruction), "")


def test_fork_goes_on_in_the_middle() -> None:
    """What was changed in the database, said and called is part of the state."""
    talk, untouched = Talk(), TauEnv("gem_tau:sample")
    talk.assistant(written(*CANCEL))
    talk.assistant("It is cancelled.")
    other = talk.env.fork()
    for actions in ({"user": "Thanks"}, {"assistant": written(*LOOK)}, {"assistant": "Else?"}, {"user": STOP}):
        assert talk.env.step(actions) == other.step(actions)
    assert other.cumulative["assistant"] == 1.0
    assert untouched.task_set.database["orders"]["#1042"]["status"] == "pending"


def test_calls_decide_where_a_task_says_so() -> None:
    """Tasks of tau2-bench may ask for the reference actions themselves; they are part of the state."""
    env = TauEnv("gem_tau:sample")
    tasks = tuple(replace(task, reward_basis=("ACTION",)) for task in env.task_set.tasks)
    env.task_set = replace(env.task_set, tasks=tasks)
    assert Talk(env=env).end()[1]["assistant"] == 0.0
    talk = Talk(env=env)
    talk.assistant(written(*CANCEL))
    for each in (env.fork(), env):
        each.step({"assistant": "Done."})
        assert each.step({"user": STOP})[1]["assistant"] == 1.0


def test_tools_are_explained_where_they_are_not_offered() -> None:
    """An agent without native calls reads in the system text how to call the tools; another reads the policy alone."""

    class Assistant:
        reads = "messages"

        def __call__(self, observation: Any, context: gem.Context) -> str:
            self.read = observation
            return "Hello."

    for native_tools in (False, True):
        assistant = Assistant()
        assistant.native_tools = native_tools  # type: ignore[attr-defined]
        agents = {"assistant": assistant, "user": lambda _, context: STOP if context.turn else "Hi."}
        (joint,) = gem.rollout("tau:Sample", agents=agents, episodes=1)
        assert joint.error is None
        system, first = assistant.read
        assert first == {"role": "user", "content": "Hi."}
        assert ("<tool_call>" in system["content"]) is not native_tools


def test_solo_plays_the_user_inside() -> None:
    """An environment for the assistant alone begins with the user's words, and its infos are the assistant's."""
    env = gem.make("tau:Sample-solo", user=["tau-user:terse", "tau-user:patient"])
    assert env.unwrapped.num_tasks == 10
    openings = {env.reset(seed=seed, options={"index": 0})[0] for seed in range(12)}
    assert len(openings) == 2  # one of the users is drawn
    env = gem.make("tau:Sample-solo", user="tau-user:terse")
    observation, info = env.reset(seed=0, options={"index": 0})
    assert observation == "Cancel an order." in openings
    assert (info["system"].startswith("# Policy"), len(info["tools"])) == (True, 8)
    assert env.step("What is your e-mail address?")[0] == "ines.castro@example.com."
    assert env.step(native(CANCEL))[4]["messages"][0]["tool_call_id"] == "a"
    assert env.step("It is done.")[4]["correct"]
    (episode,) = gem.rollout("tau:Sample-solo", load_agent("tau-assistant:careful"), episodes=1)
    assert episode.success


def test_folder_without_tasks_is_refused(tmp_path: Path) -> None:
    """It could not begin an episode."""
    (write_tau(tmp_path) / "tasks_test.json").write_text("[]")
    with pytest.raises(DatasetError, match="has no task"):
        TauEnv(tmp_path)


def test_plugin_keeps_its_promises() -> None:
    """It loads nothing heavy, and its entry points take the arguments that are registered or asked for."""
    check_plugin("gem-tau")


@pytest.mark.thorough
@pytest.mark.parametrize("env_id", ["tau:Sample", "tau:Sample-solo"])
def test_environments_keep_the_contract(env_id: str) -> None:
    """All that ``check_env`` tries."""
    assert check_env(env_id).skipped == {}


def test_gold_actions_get_the_reward() -> None:
    """The reference actions, then what the user has to be told; the user has none."""
    env = gem.make("tau:Sample-solo")
    for index in range(env.num_tasks):
        env.reset(seed=0, options={"index": index})
        over = False
        while not over:
            _, reward, terminated, truncated, _ = env.step(env.gold_action())
            over = terminated or truncated
        assert reward == 1.0
    assert Talk().env.gold_action("user") is None
