"""The conversation of an episode, whatever its view: what agents are sent and can reach, and what the record says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import pytest
from PIL import Image
from toys import Calculator, CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.records.episode import Episode
from gem_core.records.files import read_episodes, write_episodes
from gem_core.rollouts.agent import Context
from gem_core.tools.env import ToolEnv
from gem_core.types import Observation, Response

TOOLS = [Calculator(), Notebook()]
INSTRUCTIONS = "You may use tools before you answer. You have 5 tool calls.\n"


def native(*calls: tuple[str, str, str]) -> list[dict[str, Any]]:
    """Return native calls from (id, name, arguments)."""
    return [{"id": i, "type": "function", "function": {"name": n, "arguments": a}} for i, n, a in calls]


SUM = ("c1", "calculator", '{"left": 1, "right": 2}')
NOTE = ("c2", "note", '{"line": "three"}')
BAD = ("", "calculator", "{bad")

ANSWERS = [
    Response("I add.", tool_calls=native(SUM)),
    Response("<note>three</note>"),
    Response("", tool_calls=native(NOTE, BAD)),
    Response("stop"),
]

CHAT = [
    {"role": "assistant", "content": "I add.", "tool_calls": native(SUM)},
    {
        "role": "tool",
        "tool_call_id": "c1",
        "content": "3.0\nTool calls left: 4. Call a tool again, or give your answer.",
    },
    {"role": "assistant", "content": "<note>three</note>"},
    {
        "role": "user",
        "content": "Output of note:\nthree\nTool calls left: 3. Call a tool again, or give your answer.\n",
    },
    {"role": "assistant", "content": "", "tool_calls": native(NOTE, ("call_1", *BAD[1:]))},
    {"role": "tool", "tool_call_id": "c2", "content": "three\nthree"},
    {
        "role": "tool",
        "tool_call_id": "call_1",
        "content": "Error from calculator:\nThe call could not be read: its arguments are no valid JSON: Expecting "
        "property name enclosed in double quotes: line 1 column 2 (char 1)\nTool calls left: 1. Call a tool again, or "
        "give your answer.",
    },
    {"role": "assistant", "content": "stop"},
]


class Scripted:
    """Answers as it was told, and keeps what it was sent and what it could reach."""

    def __init__(self, answers: list[Response] = ANSWERS, **says: Any) -> None:
        self.answers = answers
        self.sent: list[Observation] = []
        self.reached: list[list[dict[str, Any]]] = []
        vars(self).update(says)

    def __call__(self, observation: Observation, context: Context) -> str:
        self.sent.append(observation)
        self.reached.append(context.messages)
        return self.answers[context.turn]


def played(agent: Any, wrappers: list[Any] = TOOLS, env: str = "toy:Echo-v0", **options: Any) -> Episode:
    """Return an episode of an agent."""
    with gem.make_vec(env, 1, wrappers=wrappers, **options) as vector:
        (episode,) = gem.rollout(vector, agent, episodes=1, seed=1)
    return episode


def test_an_agent_that_reads_messages_is_sent_the_conversation() -> None:
    """Question, calls and results under their ids, each time beginning with what was sent before; the tools once."""
    agent = Scripted(reads="messages", native_tools=True, system="Be brief.")
    episode = played(agent)
    opening = [
        {"role": "system", "content": "Be brief."},
        {"role": "user", "content": f"Say something.\n{INSTRUCTIONS}"},
    ]
    assert agent.sent == [[*opening, *CHAT[:end]] for end in (0, 2, 4, 7)]
    assert (episode.reads, episode.system, episode.native_tools) == ("messages", "Be brief.", True)
    assert [episode.sent(turn) for turn in range(4)] == agent.sent


@pytest.mark.parametrize("view", ["latest", "concat", "concat_with_action", "messages"])
def test_a_view_that_was_named_says_what_is_sent(view: str) -> None:
    """And what it shows does not explain native tools again."""
    agent = Scripted([Response("<note>three</note>"), Response("stop")], reads="messages", native_tools=True)
    episode = played(agent, [*TOOLS, view])
    task, call, answer = f"Say something.\n{INSTRUCTIONS}", "<note>three</note>", CHAT[3]["content"].replace("3", "4")
    shown: dict[str, Observation] = {
        "latest": answer,
        "concat": task + answer,
        "concat_with_action": f"{task}{call}\n{answer}",
        "messages": [
            {"role": "user", "content": task},
            {"role": "assistant", "content": call},
            {"role": "user", "content": answer},
        ],
    }
    assert agent.sent == [[{"role": "user", "content": task}] if view == "messages" else task, shown[view]]
    assert (episode.reads, episode.info["view"]) == ("observation", view)


EXPLAINED = str(ToolEnv(EchoEnv(), TOOLS).reset()[0])
TEXT_OF_TWO = f"""\
{EXPLAINED}\
I add.
<tool_call>{{"name": "calculator", "arguments": {{"left": 1, "right": 2}}}}</tool_call>
Output of calculator:
3.0
Tool calls left: 4. Call a tool again, or give your answer.
"""
NEWEST = "Output of calculator:\n3.0\nTool calls left: 4. Call a tool again, or give your answer.\n"


@pytest.mark.parametrize(
    ("says", "view", "reads", "second"),
    [
        ({}, [], "concat_with_action", TEXT_OF_TWO),
        ({"reads": "observation"}, [], "observation", NEWEST),
        ({"reads": "messages"}, [], "messages", [{"role": "user", "content": EXPLAINED}, *CHAT[:2]]),
        ({}, ["latest"], "observation", NEWEST),
        ({"reads": "messages"}, ["latest"], "observation", NEWEST),
    ],
)
def test_an_agent_is_sent_what_it_reads(says: dict[str, Any], view: list[str], reads: str, second: Any) -> None:
    """One that says nothing is sent the conversation as text, where tools answer and no view was named."""
    agent = Scripted(**says)
    episode = played(agent, [*TOOLS, *view])
    assert agent.sent[1] == second
    assert episode.reads == reads
    assert [episode.sent(turn) for turn in range(episode.turns)] == agent.sent
    assert agent.reached[1][1:] == CHAT[:2]


@pytest.mark.parametrize("backend", ["sync", "async", "process"])
@pytest.mark.parametrize("view", [[], ["latest"], ["concat"], [("messages", {"max_turns": 1})], ["concat_with_action"]])
@pytest.mark.few(6)
def test_every_view_and_backend_has_the_same_conversation(tmp_path: Path, backend: str, view: list[Any]) -> None:
    """For the agent while it acts, and afterwards for whoever reads the record or its file."""
    agent = Scripted()
    episode = played(agent, [*TOOLS, *view], backend=backend)
    opening = {"role": "user", "content": EXPLAINED}
    whole = [opening, *CHAT, {"role": "user", "content": "Heard: stop"}]
    assert episode.messages == whole
    assert agent.reached == [whole[:end] for end in (1, 3, 5, 8)]
    write_episodes(tmp_path / "a.jsonl", [episode])
    (read,) = read_episodes(tmp_path / "a.jsonl")
    assert read.messages == whole
    assert read == episode


def test_a_view_inside_the_tools_is_none_of_the_whole() -> None:
    """It does not show what the tools say."""
    agent = Scripted()
    episode = played(agent, ["concat", *TOOLS])
    assert episode.reads == "concat_with_action"
    assert agent.sent[1] == TEXT_OF_TWO
    assert episode.messages[1:-1] == CHAT


class Advised(Notebook):
    """Tells more than its schema does."""

    name = "advised"

    def instructions(self) -> str:
        """Return a line more."""
        return f"{super().instructions()}\nWrite short lines."


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"max_tool_uses": 1}, "Say something.\nYou may use tools before you answer. You have 1 tool call.\n{}"),
        ({"max_tool_uses": None}, "Say something.\nYou may use tools before you answer.\n{}"),
        ({"instructions": "Own words."}, "Say something.\nOwn words.\n"),
    ],
)
def test_what_no_schema_tells_is_told_with_native_tools(options: dict[str, Any], told: str) -> None:
    """The limit, the hints of a tool, and the user's own words."""
    agent = Scripted([Response("stop")], reads="messages", native_tools=True)
    env = ToolEnv(EchoEnv(), [Notebook(), Advised()], **options)
    list(gem.rollout(env, agent, episodes=1))
    hints = "- advised: Write short lines.\n"
    assert agent.sent[0] == [{"role": "user", "content": told.format(hints)}]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (native(SUM)[0], '{"name": "calculator", "arguments": {"left": 1, "right": 2}}'),
        (native(BAD)[0], '{"name": "calculator", "arguments": {bad}'),
        (native(("x", "look", ""))[0], '{"name": "look", "arguments": {}}'),
        ({"function": {"name": "look", "arguments": {"at": "ä"}}}, '{"name": "look", "arguments": {"at": "ä"}}'),
        ({"function": None}, '{"name": "", "arguments": {}}'),
    ],
)
def test_concat_with_action_shows_native_calls_as_text(call: dict[str, Any], text: str) -> None:
    """In the form in which the text could have called the tool, behind what was said."""
    view = gem.make("toy:Echo-v0", wrappers="concat_with_action")
    view.reset()
    observation, *_ = view.step(Response("so", tool_calls=[call, *native(SUM)]))
    sum_text = '<tool_call>{"name": "calculator", "arguments": {"left": 1, "right": 2}}</tool_call>'
    assert observation == f"Say something.\nso\n<tool_call>{text}</tool_call>\n{sum_text}\nHeard: so"


@pytest.mark.parametrize("says", [{}, {"reads": "messages"}, {"reads": "observation"}])
@pytest.mark.parametrize(
    ("observation", "info"),
    [
        ([1, {"type": "text"}, {"text": None}, {"content": [None]}], {}),
        ("fine", {"feedback": None, "suffix": 3, "messages": "none", "system": 5, "tool_instructions": {"text": ""}}),
        ("fine", {"view": None, "messages": [3], "tool_instructions": "none"}),
        ([{"role": "user"}, {"role": None, "content": 3}], {"system": "s"}),
    ],
)
def test_what_an_environment_should_not_say_ends_no_run(says: dict[str, Any], observation: Any, info: Any) -> None:
    """It is shown as well as it can be."""

    class Odd(EchoEnv):
        def reset(self, seed: Any = None, options: Any = None) -> Any:
            super().reset(seed)
            return observation, {"tools": [Calculator().schema()], **info}

        def step(self, action: str) -> Any:
            return observation, 0.0, action == "stop", False, dict(info)

    agent = Scripted([Response("a", tool_calls=native(SUM)), Response("stop")], native_tools=True, **says)
    (episode,) = gem.rollout(Odd(), agent, episodes=1)
    assert (episode.turns, episode.error) == (2, None)
    assert episode.messages


@pytest.mark.parametrize(("native", "system"), [(False, "Be kind.\nCall it so."), (True, "Be kind.")])
def test_system_text_explains_tools_only_where_they_are_not_offered(native: bool, system: str) -> None:
    """``info["tool_instructions"]`` holds for the system text as well."""

    class Told(EchoEnv):
        def reset(self, seed: Any = None, options: Any = None) -> Any:
            observation, info = super().reset(seed)
            told = {"text": "\nCall it so.", "native": ""}
            info |= {"system": "Be kind.\nCall it so.", "tools": [Calculator().schema()], "tool_instructions": told}
            return observation, info

    agent = Scripted(["stop"], native_tools=native, reads="messages")
    (episode,) = gem.rollout(Told(), agent, episodes=1)
    assert episode.messages[0] == {"role": "system", "content": system}


def test_the_conversation_is_what_agents_were_shown(tmp_path: Path) -> None:
    """With images and what a wrapper that is no view writes; what an agent does to its messages stays with it."""
    picture = Image.new("RGB", (8, 8), "red")

    class Picture(CountdownEnv):
        def step(self, action: str) -> Any:
            return [{"type": "image", "image": picture}], *super().step(action)[1:4], {}

    def agent(observation: Any, context: Context) -> str:
        assert context.observation is not observation
        observation[-1]["content"] = "changed"
        observation.clear()
        context.messages.clear()
        return "a!"

    agent.reads = "messages"  # type: ignore[attr-defined]
    shouting = gymnasium.wrappers.TransformObservation(
        Picture(longest=1), lambda seen: seen.upper() if isinstance(seen, str) else seen, None
    )
    (episode,) = gem.rollout(shouting, agent, episodes=1, seed=1)
    write_episodes(tmp_path / "a.jsonl", [episode])
    (read,) = read_episodes(tmp_path / "a.jsonl")
    assert episode.messages == read.messages
    assert episode.messages == [
        {"role": "user", "content": "COUNT DOWN.\nLEFT: 1."},
        {"role": "assistant", "content": "a!"},
        {"role": "user", "content": [{"type": "image", "image": picture}]},
    ]
