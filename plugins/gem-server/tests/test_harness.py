"""``Harness``: programs that own their loop play environments, and every request is a turn."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.rollouts import Context
from gem_core.types import TERMINAL_STATE, Response
from gem_server.harness import Harness

PROGRAM = str(Path(__file__).with_name("program.py"))


class CountdownEnv(gem.Env):
    """Says how many steps are left; each is worth 1, and "stop" fails."""

    def __init__(self, length: int = 3) -> None:
        super().__init__()
        self.length = length

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
        super().reset(seed=seed)
        self.left = self.length
        return f"Count down: {self.left}.", {}

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        if action == "stop":
            raise RuntimeError("broken on purpose")
        self.left -= 1
        over = self.left == 0
        return TERMINAL_STATE if over else f"Left: {self.left}.", 1.0, over, False, {"said": action, "correct": over}


def played(
    agent: Any, *how: str, length: int = 3, api: str = "chat", command: Any = None, **options: Any
) -> list[gem.Episode]:
    command = [sys.executable, PROGRAM, api, *how] if command is None else command
    env = Harness(CountdownEnv(length), command, **options)
    with env:
        return list(gem.rollout(env, agent, episodes=1, seed=1))


async def counting(observation: Any, context: Context) -> Response:
    return Response(f"reply {context.turn}", usage={"prompt_tokens": 7, "completion_tokens": 2}, model="scripted")


@pytest.mark.parametrize("how", [[], ["streamed"]], ids=["whole", "streamed"])
@pytest.mark.parametrize("api", ["chat", "responses", "messages"])
def test_a_program_plays_by_each_api(api: str, how: list[str]) -> None:
    """Its requests are the observations, the replies the actions, and each turn has its reward."""
    (episode,) = played(counting, *how, api=api)
    assert episode.error is None
    assert [(str(turn.action), turn.reward) for turn in episode.transitions] == [(f"reply {n}", 1.0) for n in range(3)]
    assert [turn.info["said"] for turn in episode.transitions] == ["reply 0", "reply 1", "reply 2"]
    assert (episode.success, episode.transitions[-1].terminated) == (True, True)
    shown: Any = episode.transitions[1].observation
    assert [message["role"] for message in shown] == ["system", "user", "assistant", "user"]
    assert [message["content"] for message in shown[1:]] == ["Count down: 3.", "reply 0", "Left: 2."]
    assert episode.info["request"]["model"] == "m"


def test_several_episodes_at_once_are_each_their_own() -> None:
    """As many programs as slots."""
    command = [sys.executable, PROGRAM, "chat"]
    gem.register("harnessed:Countdown-v0", CountdownEnv)
    wrapped = ("harnessed:Countdown-v0", {"wrappers": [("harness", {"command": command})]})
    plan = [gem.PlanItem(kwargs={**wrapped[1], "length": 1 + place}) for place in range(3)]
    episodes = sorted(gem.rollout([wrapped], counting, plan=plan, num_envs=3, seed=1), key=lambda one: one.key)
    assert [(one.turns, one.episode_return, one.error) for one in episodes] == [
        (1, 1.0, None),
        (2, 2.0, None),
        (3, 3.0, None),
    ]


def test_a_history_that_was_shortened_begins_a_segment() -> None:
    """So that training knows which requests continue each other."""
    (episode,) = played(counting, "forgets")
    assert [turn.info.get("request", {}).get("segment") for turn in episode.transitions] == [1, 2, None]
    (episode,) = played(counting)
    assert [turn.info.get("request", {}).get("segment") for turn in episode.transitions] == [0, 0, None]


def test_what_a_program_prints_is_its_answer_if_it_never_acts() -> None:
    """As of a program that answers one question."""
    (episode,) = played(counting, "prints", length=1)
    assert (episode.transitions[0].info["said"], episode.episode_return) == ("reply 0", 1.0)
    assert episode.transitions[0].terminated


def test_a_program_that_ends_early_is_cut_off_with_what_it_earned() -> None:
    """It is no error: the program could have gone on."""
    (episode,) = played(counting, "leaves")
    last = episode.transitions[-1]
    assert (last.truncated, last.info["cut_off"], last.info["harness"]["exit_code"]) == (True, "harness", 0)
    assert episode.error is None


def test_a_program_that_takes_too_long_is_killed() -> None:
    """The episode is cut off, and nothing of the program is left."""
    (episode,) = played(counting, "hangs", timeout_s=3.0)
    assert episode.transitions[-1].info["harness"] == {"cut_off": "the program took longer than 3 s"}


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["no-such-program-of-anybody"], "cannot be started"),
        (
            [sys.executable, "-c", "print('hello'); raise SystemExit(3)"],
            "with exit code 3 before it asked the model: hello",
        ),
        ([sys.executable, "-c", "import os; print(os.environ['OPENAI_API_KEY'])"], "the model: [key]"),
    ],
)
def test_a_program_that_never_asks_is_an_error_of_the_machinery(command: list[str], told: str) -> None:
    """Told with what it printed, but for its key."""
    (episode,) = played(counting, command=command)
    assert episode.error is not None
    assert told in episode.error["message"]


def test_an_environment_that_fails_is_an_error_and_not_the_programs() -> None:
    """Though it fails while the program acts."""
    (episode,) = played(lambda observation, context: "stop")
    assert episode.error is not None
    assert "broken on purpose" in episode.error["message"]


def test_native_calls_and_their_results_pass_through() -> None:
    """The program's tools are offered to the agent, whose calls come back in the API's own form."""
    script = """
import json, os, urllib.request
def post(body):
    head = {"authorization": "Bearer " + os.environ["OPENAI_API_KEY"]}
    url = os.environ["OPENAI_BASE_URL"] + "/chat/completions"
    return json.load(urllib.request.urlopen(urllib.request.Request(url, json.dumps(body).encode(), head)))
tools = [{"type": "function", "function": {"name": "look", "parameters": {"type": "object"}}}]
messages = [{"role": "user", "content": "look"}]
said = post({"messages": messages, "tools": tools})["choices"][0]
assert said["finish_reason"] == "tool_calls", said
call = said["message"]["tool_calls"][0]
messages += [said["message"], {"role": "tool", "tool_call_id": call["id"], "content": call["function"]["arguments"]}]
print(post({"messages": messages, "tools": tools})["choices"][0]["message"]["content"])
"""
    seen: list[Any] = []

    def agent(observation: Any, context: Context) -> Response:
        seen.append((observation, context.tools))
        call = {"id": "c1", "type": "function", "function": {"name": "look", "arguments": '{"at": "sky"}'}}
        return Response("blue") if context.turn else Response("", tool_calls=[call])

    (episode,) = played(agent, length=1, command=[sys.executable, "-c", script])
    assert episode.transitions[-1].info["said"] == "blue"
    assert seen[0][1][0]["function"]["name"] == "look"
    assert seen[1][0][-1] == {"role": "tool", "content": '{"at": "sky"}', "tool_call_id": "c1"}


def test_what_cannot_be_is_refused() -> None:
    """A command that is empty, and a copy of a running program."""
    with pytest.raises(ArgumentError, match="command"):
        Harness(CountdownEnv(), "")
    with pytest.raises(StateNotSupported):
        Harness(CountdownEnv(), "x").fork()  # type: ignore[attr-defined]  # read from the environment inside
