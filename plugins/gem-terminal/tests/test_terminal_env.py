"""What ``TerminalEnv`` makes of actions, verdicts, limits and failures, on a backend, shell and verifier in memory."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from memory_backend import MemoryMachine, plain_task
from scripted import Script, ScriptedShell, result

import gem_core as gem
from gem_core.errors import ArgumentError, ResetNeededError, StateNotSupported
from gem_terminal import TerminalEnv, episode
from gem_terminal.errors import EngineError, MachineLostError, TaskError
from gem_terminal.verifying.verdict import Verdict


@pytest.fixture
def env(make: Any) -> TerminalEnv:
    """An environment of three tasks."""
    return make()


def test_first_observation_is_the_task_and_how_to_act(make: Any) -> None:
    """It names every form of an action, the limits, what a malformed response costs, the directory and the turns."""
    env = make(most_command_timeout_s=600, agent_timeout_s=900, show_time=True)
    observation, info = env.reset(seed=1, options={"task": "two"})
    assert observation.startswith("Do two.\n\nYou work in a terminal.")
    assert observation.endswith("\n[/app · 50 turns left · 14 min left]")
    assert observation == info["feedback"] + info["suffix"]
    assert (info["task_id"], info["index"]) == ("two", 1)
    assert info["terminal"] == {"backend": "memory", "shortfall": []}
    assert [tool["function"]["name"] for tool in info["tools"]] == ["bash", "keys", "finish"]
    forms = ("<bash>", "<keys>", "<finish/>", "120x40")
    limits = ("after 60 seconds", "at most 600", "50 turns and 15 minutes", "a reward of -0.1", "5 responses in a row")
    assert [words for words in (*forms, *limits) if words not in info["tool_instructions"]["text"]] == []


def test_a_model_with_native_tools_is_told_the_limits_and_not_of_tags(env: TerminalEnv) -> None:
    class Native:
        reads, native_tools = "messages", True

        def __call__(self, observation: Any, context: Any) -> str:
            self.sent = observation[0]["content"]
            return "<finish/>"

    list(gem.rollout(env, agent := Native(), episodes=1, seed=1))
    assert "killed after 60 seconds" in agent.sent
    assert "<bash>" not in agent.sent


def test_what_an_action_did_is_told(env: TerminalEnv, script: Script) -> None:
    """Output, exit code, directory and notes; the first action alone is done."""
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("I look. <bash>ls</bash><bash>pwd</bash><finish/>")
    told = "2 further actions were ignored: each response does one thing."
    assert (
        observation == f"ran ls\n[exit code 0]\n[{told}]\n[/app · 49 turns left]" == info["feedback"] + info["suffix"]
    )
    assert (reward, terminated, truncated, len(script.limits)) == (0.0, False, False, 1)
    assert (info["parsed_action"], info["terminal"]["exit_code"]) == ("I look. <bash>ls</bash>", 0)
    script.on_run = lambda command, limit: result("begun", None, timed_out=True, note="It ran too long.")
    observation, _, _, _, info = env.step("<bash>x</bash>")
    assert observation.startswith("begun\n[It ran too long.]\n")
    assert (info["terminal"]["timed_out"], info["terminal"]["exit_code"]) == (True, None)
    observation, _, _, _, info = env.step("<keys>:q<Enter></keys>")
    assert observation.startswith("typed :q<Enter>\n[a program is running in the terminal]")
    assert info["terminal"]["running"] is True


def test_finish_runs_the_tests(env: TerminalEnv, script: Script) -> None:
    """The reward is the verdict's, the machine is gone, the tests are in the info, and no path of this machine."""
    _, first = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert observation == "The tests have passed."
    assert info["terminal"]["ended_by"] == "finish"
    assert [test["name"] for test in info["verifier"]["tests"]] == ["test_one", "test_two"]
    assert script.closed == 1
    text = json.dumps([first, info])
    assert "/nowhere" not in text
    assert str(Path.home()) not in text.replace('"/root"', "")


@pytest.mark.parametrize(
    ("options", "workdir", "where", "artifacts"),
    [
        ({}, "/app", "machine", ("/app",)),
        ({"verify_in": "judge"}, "/app", "judge", ("/app",)),
        ({"verify_in": "judge", "artifacts": ["/out", "/srv"]}, "/", "judge", ("/out", "/srv")),
        ({"verify_in": "judge", "artifacts": "/out"}, "/", "judge", ("/out",)),
    ],
)
def test_tests_run_where_they_are_asked_to(
    make: Any, monkeypatch: pytest.MonkeyPatch, script: Script, options: Any, workdir: str, where: str, artifacts: Any
) -> None:
    """In a judge with the folder that the agent begins in, wherever it goes, or what is asked for."""
    monkeypatch.setattr(ScriptedShell, "workdir", workdir)
    env = make(**options)
    env.reset(seed=1)
    monkeypatch.setattr(ScriptedShell, "workdir", "/tmp")
    env.step("<finish/>")
    assert (script.verified[0]["where"], script.verified[0]["artifacts"]) == (where, artifacts)


def test_judge_without_a_folder_to_carry_is_an_error_of_the_reset(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole of a machine is not carried."""
    monkeypatch.setattr(ScriptedShell, "workdir", "/")
    with pytest.raises(TaskError, match="artifacts="):
        make(verify_in="judge").reset(seed=1)


def test_malformed_action_is_told_and_costs_little(make: Any) -> None:
    """The episode goes on; after so many in a row it ends, and the tests run; with None only the turns end it."""
    env = make(max_malformed=2, malformed_penalty=-0.25)
    env.reset(seed=1)
    observation, reward, terminated, _, info = env.step("hello")
    assert "There is no action in the response." in observation
    assert (reward, terminated, info["parsed_action"]) == (-0.25, False, None)
    env.step("<bash>true</bash>")
    assert env.step("<bash>")[2] is False
    _, reward, terminated, truncated, info = env.step("")
    assert (reward, terminated, truncated) == (0.75, True, False)
    assert info["terminal"]["ended_by"] == "malformed"
    env = make(max_malformed=None, max_turns=30)
    env.reset(seed=1)
    assert not any(env.step("?")[2] for _ in range(29))
    assert env.step("?")[4]["terminal"]["ended_by"] == "turns"


@pytest.mark.parametrize(
    ("options", "action", "told", "reward", "ended_by", "ran"),
    [
        ({"max_turns": 1}, "<bash>a</bash>", "ran a\n[exit code 0]\nThe tests have passed.", 1.0, "turns", 1),
        ({"agent_timeout_s": 1e-6}, "<bash>a</bash>", "The tests have passed.", 1.0, "agent_timeout", 0),
        ({"episode_timeout_s": 1e-6}, "<bash>a</bash>", "", 0.0, "episode_timeout", 0),
    ],
)
def test_an_episode_that_reaches_a_limit_ends(
    make: Any, script: Script, options: Any, action: str, told: str, reward: float, ended_by: str, ran: int
) -> None:
    """The last turn is done and judged, what comes too late is not done; a whole episode out of time is a failure."""
    env = make(**options)
    env.reset(seed=1)
    observation, *outcome, info = env.step(action)
    assert observation.endswith(told)
    assert outcome == [reward, True, False]
    assert (info["correct"], info["terminal"]["ended_by"], "error" in info) == (reward == 1, ended_by, False)
    assert (len(script.limits), len(script.verified)) == (ran, int(reward))


def test_machine_is_removed_when_the_time_of_the_episode_is_over(make: Any, script: Script) -> None:
    """Though the agent never comes back."""
    env = make(episode_timeout_s=0.2)
    env.reset(seed=1)
    deadline = time.monotonic() + 30
    while script.backend.live and time.monotonic() < deadline:
        pass
    assert script.backend.live == {}
    assert env.step("<bash>late</bash>")[2] is True


def test_limits_of_commands_nest(make: Any, script: Script) -> None:
    """A command's is the one asked for, but no more than may be asked for, and than the agent has left."""
    env = make(command_timeout_s=10, most_command_timeout_s=20, agent_timeout_s=1000)
    env.reset(seed=1)
    for words in ("<bash>a</bash>", '<bash timeout="15">a</bash>', '<bash timeout="500">a</bash>'):
        env.step(words)
    assert script.limits == [10, 15, 20]
    short = make(agent_timeout_s=5)
    short.reset(seed=1)
    short.step("<bash>a</bash>")
    assert 0 < script.limits[-1] <= 5


@pytest.mark.parametrize("blame", ["agent", "task", None])
def test_verifier_without_a_verdict(env: TerminalEnv, script: Script, blame: Any) -> None:
    """A failure where the agent is the cause; else an error, never a reward of 0 that training learns from."""
    script.verdicts = [Verdict(False, 0.0, problem="timeout", blame=blame, detail="too slow")]
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated) == (0.0, blame == "agent", blame != "agent")
    if blame == "agent":
        assert (observation, info["correct"]) == ("The tests gave no result.", False)
    assert info.get("error") == (None if blame == "agent" else {"kind": "verifier", "message": "too slow"})


@pytest.mark.parametrize(
    ("failure", "error"),
    [
        (MachineLostError("full", by_agent=True), None),
        (MachineLostError("full", by_agent=False), {"kind": "machine", "message": "full"}),
        (MachineLostError("full", by_agent=None), {"kind": "machine", "message": "full"}),
        (EngineError("no engine"), {"kind": "engine", "message": "no engine"}),
    ],
)
def test_lost_machine(env: TerminalEnv, script: Script, failure: Exception, error: Any) -> None:
    """The agent's doing is scored; anything else, and what is not known, is an error."""

    def lose(command: str, limit: float) -> Any:
        raise failure

    script.on_run = lose
    env.reset(seed=1)
    observation, *outcome, info = env.step("<bash>eat</bash>")
    assert (outcome, info.get("error")) == ([0.0, error is None, error is not None], error)
    if error is None:
        assert (info["correct"], observation) == (False, "The machine is lost: full")
    with pytest.raises(ResetNeededError):
        env.step("<bash>ls</bash>")


def test_machine_that_ended_before_the_first_action_is_an_error(
    env: TerminalEnv, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The agent has done nothing, whatever it looks like; later, it may have."""
    env.reset(seed=1)
    monkeypatch.setattr(MemoryMachine, "why_lost", lambda machine: MachineLostError("it ended", by_agent=True))
    *_, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated, info["error"]["kind"]) == (0.0, False, True, "machine")
    assert script.verified == []


def test_a_failing_reset_raises_and_leaves_no_machine(
    env: TerminalEnv, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise EngineError("no engine; start one")

    script.backend.on_start = fail
    with pytest.raises(EngineError):
        env.reset(seed=1)
    script.backend.on_start = None
    assert env.reset(seed=1)[1]["task_id"]
    monkeypatch.setattr(episode, "Shell", fail)
    with pytest.raises(EngineError):
        env.reset(seed=1)


def test_native_calls_are_answered_under_their_ids(env: TerminalEnv) -> None:
    """The first is executed, the others are told that they were not."""
    env.reset(seed=1)
    calls = [
        {"id": name, "type": "function", "function": {"name": "bash", "arguments": json.dumps({"command": name})}}
        for name in ("a", "b")
    ]
    observation, _, _, _, info = env.step(gem.Response("", tool_calls=calls))
    assert observation.startswith("ran a")
    assert info["messages"][0] == {"role": "tool", "tool_call_id": "a", "content": observation}
    assert info["messages"][1]["tool_call_id"] == "b"
    assert info["messages"][1]["content"].startswith("Not done")


def test_seed_chooses_the_task_and_options_overrule_it(env: TerminalEnv) -> None:
    """The same seed gives the same task, and the same random actions; an index or a name takes that one."""
    drawn = [(env.reset(seed=seed)[1]["task_id"], env.sample_random_action()) for seed in range(12)]
    assert drawn == [(env.reset(seed=seed)[1]["task_id"], env.sample_random_action()) for seed in range(12)]
    assert {name for name, _ in drawn} == {"one", "two", "three"}
    assert [env.reset(options={"index": index})[1]["task_id"] for index in range(3)] == ["one", "two", "three"]
    assert "<finish/>" in [env.sample_random_action() for _ in range(50)]
    assert env.num_tasks == 3
    with pytest.raises(StateNotSupported):
        env.fork()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "twoo"}, "Did you mean 'two'?"),
        ({"index": 3}, "from 0 to 2, not 3"),
        ({"index": True}, "not True"),
        ({"tusk": "one"}, "Did you mean 'task'?"),
        ({"task": "one", "index": 0}, "one of task and index"),
    ],
)
def test_wrong_options(env: TerminalEnv, options: dict[str, Any], words: str) -> None:
    """The message says what there is."""
    with pytest.raises(ArgumentError, match=words):
        env.reset(options=options)


WRONG = {"reward": "most", "agent_timeout_s": "tusk", "episode_timeout_s": -1, "max_turns": 0, "max_malformed": 1.5}
WRONG |= {"malformed_penalty": "none", "max_output": 1, "cpus": 0, "memory_mb": True, "network": "some"}
WRONG |= {"verify_in": "auto", "artifacts": ["out"], "pool_size": -1, "weights": {"a": -1}, "columns": 5}
WRONG |= {"command_timeout_s": float("nan")}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_values_are_refused_by_name(make: Any, name: str) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} "):
        make(**{name: WRONG[name]})
    with pytest.raises(ArgumentError, match=r"^backend "):
        TerminalEnv("anywhere", backend="x")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, (-5.0, 1.0)),
        ({"malformed_penalty": 0.5, "max_turns": 4}, (0.0, 3.0)),
        ({"max_turns": None}, None),
        ({"reward": "score"}, None),
    ],
)
def test_return_range_is_declared_where_rewards_bound_it(make: Any, options: Any, expected: Any) -> None:
    """Of the verdict, and of as many malformed responses as there are turns."""
    assert make(**options).return_range == expected


def test_close_may_be_called_again_and_the_environment_used_again(make: Any, script: Script) -> None:
    """Nothing is left after each, also of machines that were made ready for the next reset."""
    env = make(plain_task("only"), pool_size=2, prestart=True)
    for _ in range(3):
        env.reset()
    deadline = time.monotonic() + 60
    while len(script.backend.made) < 5 and time.monotonic() < deadline:
        time.sleep(0.01)
    env.close()
    env.close()
    assert (len(script.backend.made) >= 5, script.backend.live) == (True, {})
    env.reset()
    assert script.backend.live


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(actions=st.lists(st.one_of(st.text(), st.sampled_from(["<bash>", "<bash>x</bash>", "<keys>", "</bash>\x00"]))))
def test_any_text_gives_an_observation_and_a_reward(env: TerminalEnv, actions: list[str]) -> None:
    """Never an exception, and an info that JSON takes."""
    env.reset(seed=1)
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        assert (type(observation), type(reward)) == (str, float)
        json.dumps(info)
        if terminated or truncated:
            break
