"""Any task with any tools, by name or object: in one place, with one budget, and made again from the record."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from toys import AsyncNotebook, Calculator, EchoEnv, Notebook

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.records.files import EpisodeWriter, read_episodes
from gem_core.tools.env import ToolEnv, find_tool_env


def layers(env: Any) -> list[str]:
    """Return the names of the wrappers around a task, outermost first, without what make puts around each."""
    names = []
    while isinstance(env, gem.Wrapper):
        names.append(type(env).__name__)
        env = env.env
    return [name for name in names if name != "Guard"]


@pytest.mark.parametrize(
    ("wrappers", "expected"),
    [
        ("box,vault,concat", ["Concat", "ToolEnv"]),
        ("concat,box,episode_stats,vault", ["EpisodeStats", "ToolEnv", "Concat"]),
        (["box", ("tools", {"tools": "vault"})], ["ToolEnv"]),
        ([("tools", {"tools": ["box"]}), ("tools", {"tools": [("vault", {})]}), "concat"], ["Concat", "ToolEnv"]),
        (["box", "vault", ("tools", {"max_tool_uses": 2})], ["ToolEnv"]),
    ],
)
def test_all_tools_share_one_wrapper(toolbox: Path, wrappers: Any, expected: list[str]) -> None:
    """In the place of the first: one explanation, one budget, one set of schemas."""
    env = gem.make("toy:Countdown-v0", wrappers=wrappers)
    assert layers(env) == expected
    observation, info = env.reset(seed=1, options={"left": 9})
    assert [tool["function"]["name"] for tool in info["tools"]] == ["look", "count", "vault"]
    assert str(observation).count("You may use tools before you answer.") == 1
    limit = env.get_wrapper_attr("max_tool_uses")
    for _ in range(limit):
        assert "tool" in env.step("<look>north</look>")[4]
    assert "tool" not in env.step("<look>north</look>")[4]


def test_options_of_tools_are_gathered(toolbox: Path) -> None:
    """Rewards and limits may stand beside the names; two that contradict each other are refused."""
    options = {"tools": ["box", ("box", {"prefix": "my_"})], "max_tool_uses": 10, "tool_reward": 0.5}
    env = gem.make("toy:Countdown-v0", wrappers=[("tools", options), "vault", "concat"])
    env.reset(seed=1)
    assert env.step("<my_look>north</my_look>")[1] == 0.5
    assert env.get_wrapper_attr("max_tool_uses") == 10
    with pytest.raises(ArgumentError, match="max_tool_uses twice"):
        gem.make("toy:Countdown-v0", wrappers=[("tools", options), ("tools", {"max_tool_uses": 3})])
    with pytest.raises(ArgumentError, match="no tool"):
        gem.make("toy:Countdown-v0", wrappers=[("tools", {"max_tool_uses": 3})])


@pytest.mark.parametrize(
    "tools",
    [
        [Notebook()],
        [Notebook],
        [("tools", {"tools": [Notebook]})],
    ],
)
def test_tools_may_be_given_as_objects(tools: Any) -> None:
    """Or classes, among names of wrappers."""
    env = gem.make("toy:Countdown-v0", wrappers=[*tools, "concat"])
    assert layers(env) == ["Concat", "ToolEnv"]
    env.reset(seed=1)
    assert "Output of note:\nx" in str(env.step("<note>x</note>")[0])


def test_a_record_names_the_tools_and_can_be_played_again(toolbox: Path, tmp_path: Path) -> None:
    """By id, keyword arguments, wrappers and seed, after it was read from a file."""
    wrappers = ["vault", ("box", {"prefix": "my_"}), "concat", ("tools", {"tool_success_reward": 0.25})]
    answers = [
        "<my_look>north</my_look>",
        json_call("vault", lock="north", key="brass"),
        "<vault>",
        "7",
        "8",
        "9",
        "10",
    ]

    def agent(observation: Any, context: Any) -> str:
        return answers[context.turn]

    with pytest.raises(ArgumentError, match="vault, my_look"):
        ToolEnv(gem.make("toy:Countdown-v0", wrappers=wrappers), [Calculator()])
    vector = gem.make_vec("toy:Countdown-v0", wrappers=wrappers)
    with EpisodeWriter(tmp_path / "run.jsonl") as writer:
        for episode in gem.rollout(vector, agent, episodes=2, seed=3):
            writer.write(episode)
    vector.close()
    for episode in read_episodes(tmp_path / "run.jsonl"):
        assert episode.tools == ["vault", "my_look", "my_count"]
        assert episode.wrappers == [
            [
                "tools",
                {"tools": [["vault", {}], ["box", {"prefix": "my_"}]], "tool_success_reward": 0.25},
            ],
            ["concat", {}],
        ]
        env = gem.make(episode.id, wrappers=episode.wrappers, **episode.kwargs)
        observation, _ = env.reset(seed=episode.seed)
        assert observation == episode.observation
        for turn in episode.transitions:
            observation, reward, terminated, truncated, info = env.step(turn.action)
            assert (reward, terminated, truncated, info) == (turn.reward, turn.terminated, turn.truncated, turn.info)
        assert observation == episode.final_observation


def json_call(name: str, **arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


def test_the_tools_explain_themselves_in_one_text() -> None:
    """Every tool with its form, the limit, and the form that suits all; pinned, since scores depend on it."""
    assert ToolEnv(EchoEnv(), [Calculator(), Notebook()], max_tool_uses=3).reset()[0] == (
        "Say something.\n"
        "You may use tools before you answer. Make one call in a response: the result comes back to you, and nothing "
        "that you write behind the call is read. You have 3 tool calls.\n"
        "- calculator: Adds or divides two numbers. Call it with <tool_call>"
        '{"name": "calculator", "arguments": {"left": "…", "right": "…", "operation": "…"}}</tool_call>\n'
        "- note: Writes a line into the notebook and shows it all. Call it with <note>line</note> or a fenced block "
        "marked note\n"
        'Any tool can also be called as <tool_call>{"name": …, "arguments": {…}}</tool_call>.\n'
    )
    assert ToolEnv(EchoEnv(), [Notebook()], max_tool_uses=0).reset()[0] == "Say something."
    assert "You have" not in ToolEnv(EchoEnv(), [Notebook()], max_tool_uses=None).reset()[0]

    class Terse(Notebook):
        description = ""

    explained = ToolEnv(EchoEnv(), [Terse()], max_tool_uses=1).reset()[0]
    assert "You have 1 tool call.\n- note: Call it with <note>line</note>" in explained
    assert ToolEnv(EchoEnv(), [AsyncNotebook()], instructions="Use it.").reset()[0] == "Say something.\nUse it.\n"


def test_tools_can_be_changed_by_a_wrapper_outside() -> None:
    """What stands for a tool is called in its place; ``find_tool_env`` finds the wrapper that offers them."""

    class Shouting(Calculator):
        def call(self, arguments: Any, session: Any) -> str:
            return f"{super().call(arguments, session)}!"

    env = gem.make("toy:Countdown-v0", wrappers=[Calculator, Notebook, ("turn_limit", {"max_turns": 9})])
    assert find_tool_env(gem.make("toy:Countdown-v0")) is None
    found = find_tool_env(env)
    assert found is env.env
    found.change_tools(lambda tool: Shouting() if tool.name == "calculator" else tool)
    env.reset(seed=1)
    assert env.step(json_call("calculator", left=2, right=3))[0].startswith("Output of calculator:\n5.0!\n")
    assert env.step("<note>a line</note>")[0].startswith("Output of note:\na line\n")
