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
from scripted import HALF, Script, ScriptedShell, make, result

import gem_core as gem
from gem_core.errors import ArgumentError, ResetNeededError, StateNotSupported
from gem_terminal import TerminalEnv, episode
from gem_terminal.errors import EngineError, MachineLostError, TaskError
from gem_terminal.verifying.verdict import Verdict


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch, script: Script) -> Any:
    """An environment of three tasks."""
    made = make(monkeypatch, script)
    yield made
    made.close()


def test_first_observation_is_the_task_and_how_to_act(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """It names every form of an action, the limits, what a malformed response costs, the directory and the turns."""
    env = make(monkeypatch, script, most_command_timeout_s=600, agent_timeout_s=900)
    observation, info = env.reset(seed=1, options={"task": "two"})
    assert observation.startswith("Do two.\n\nYou work in a terminal.")
    assert observation.endswith("\n[/app · 50 turns left]")
    assert observation == info["feedback"] + info["suffix"]
    assert (info["task_id"], info["index"]) == ("two", 1)
    assert info["terminal"] == {"backend": "memory", "shortfall": []}
    assert [tool["function"]["name"] for tool in info["tools"]] == ["bash", "keys", "finish"]
    forms = ("<bash>", "<keys>", "<finish/>", "120x40")
    limits = ("after 60 seconds", "at most 600", "50 turns and 15 minutes", "a reward of -0.1", "5 responses in a row")
    assert [words for words in (*forms, *limits) if words not in info["tool_instructions"]["text"]] == []


def test_a_model_with_native_tools_is_not_told_of_tags(env: TerminalEnv) -> None:
    """Only the limits, which no schema tells."""

    class Native:
        reads, native_tools = "messages", True

        def __call__(self, observation: Any, context: Any) -> str:
            self.sent = observation[0]["content"]
            return "<finish/>"

    list(gem.rollout(env, agent := Native(), episodes=1, seed=1))
    told = agent.sent.split("\n\n", 1)[1]
    assert told.startswith("You work in a terminal, by calling its tools. Each response does one thing;")
    assert "killed after 60 seconds; its timeout may be at most" in told
    assert "<bash>" not in told


def test_command_is_run_and_told(env: TerminalEnv, script: Script) -> None:
    """Output, exit code, directory and notes; what was behind it is not in what was read."""
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("I look. <bash>ls</bash> And then?")
    assert observation == "ran ls\n[exit code 0]\n[/app · 49 turns left]" == info["feedback"] + info["suffix"]
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert (info["parsed_action"], info["terminal"]["exit_code"]) == ("I look. <bash>ls</bash>", 0)
    script.on_run = lambda command, limit: result("begun", None, timed_out=True, note="It ran too long.")
    observation, _, _, _, info = env.step("<bash>x</bash>")
    assert observation.startswith("begun\n[It ran too long.]\n")
    assert (info["terminal"]["timed_out"], info["terminal"]["exit_code"]) == (True, None)
    observation, _, _, _, info = env.step("<keys>:q<Enter></keys>")
    assert observation.startswith("typed :q<Enter>\n[a program is running in the terminal]")
    assert info["terminal"]["running"] is True


def test_finish_runs_the_tests(env: TerminalEnv, script: Script) -> None:
    """The reward is the verdict's, the machine is gone, and the tests are in the info."""
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert observation == "The tests have passed."
    assert info["terminal"]["ended_by"] == "finish"
    assert [test["name"] for test in info["verifier"]["tests"]] == ["test_one", "test_two"]
    assert script.closed == 1
    env.close()
    assert script.backend.live == {}


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
    monkeypatch: pytest.MonkeyPatch, script: Script, options: Any, workdir: str, where: str, artifacts: Any
) -> None:
    """In a judge with the folder that the agent begins in, wherever it goes, or what is asked for."""
    monkeypatch.setattr(ScriptedShell, "workdir", workdir)
    env = make(monkeypatch, script, **options)
    env.reset(seed=1)
    monkeypatch.setattr(ScriptedShell, "workdir", "/tmp")
    env.step("<finish/>")
    assert (script.verified[0]["where"], script.verified[0]["artifacts"]) == (where, artifacts)


def test_judge_without_a_folder_to_carry_is_an_error_of_the_reset(
    monkeypatch: pytest.MonkeyPatch, script: Script
) -> None:
    """The whole of a machine is not carried."""
    monkeypatch.setattr(ScriptedShell, "workdir", "/")
    env = make(monkeypatch, script, verify_in="judge")
    with pytest.raises(TaskError, match="artifacts="):
        env.reset(seed=1)
    env.close()
    assert script.backend.live == {}


def test_further_actions_are_ignored_and_that_is_told(env: TerminalEnv, script: Script) -> None:
    """Behind what the first one showed."""
    env.reset(seed=1)
    observation = env.step("<bash>ls</bash><bash>pwd</bash><finish/>")[0]
    assert observation.startswith(
        "ran ls\n[exit code 0]\n[2 further actions were ignored: each response does one thing.]\n"
    )
    assert len(script.limits) == 1


def test_time_left_is_told_only_when_asked(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """Without it, the same actions give the same observations."""
    for show_time, told in ((False, "[/app · 50 turns left]"), (True, "[/app · 50 turns left · 1 min left]")):
        env = make(monkeypatch, script, agent_timeout_s=100, show_time=show_time)
        observation, _ = env.reset(seed=1)
        assert observation.endswith(f"\n{told}")
        assert "50 turns and 100 seconds in all" in observation
        env.close()


@pytest.mark.parametrize(("rule", "expected"), [("all", 0.0), ("fraction", 0.5), ("weighted", 0.75), ("score", 0.5)])
def test_reward_rules(monkeypatch: pytest.MonkeyPatch, script: Script, rule: Any, expected: float) -> None:
    """One of two tests has passed, of weight 3 to 1."""
    script.verdicts = [HALF]
    env = make(monkeypatch, script, reward=rule)
    env.reset(seed=1)
    observation, reward, _, _, info = env.step("<finish/>")
    assert reward == expected
    assert info["correct"] is False
    assert observation == "1 of 2 tests have passed."
    env.close()


def test_malformed_action_is_told_and_costs_little(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """The episode goes on; after so many in a row it ends, and the tests run; with None only the turns end it."""
    env = make(monkeypatch, script, max_malformed=2, malformed_penalty=-0.25)
    env.reset(seed=1)
    observation, reward, terminated, _, info = env.step("hello")
    assert "There is no action in the response." in observation
    assert (reward, terminated, info["parsed_action"]) == (-0.25, False, None)
    env.step("<bash>true</bash>")
    assert env.step("<bash>")[2] is False
    _, reward, terminated, truncated, info = env.step("")
    assert (reward, terminated, truncated) == (0.75, True, False)
    assert info["terminal"]["ended_by"] == "malformed"
    env = make(monkeypatch, script, max_malformed=None, max_turns=30)
    env.reset(seed=1)
    assert not any(env.step("?")[2] for _ in range(29))
    assert env.step("?")[4]["terminal"]["ended_by"] == "turns"


def test_last_turn_is_done_and_then_judged(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """The command of the last turn counts."""
    env = make(monkeypatch, script, max_turns=1)
    observation, _ = env.reset(seed=1)
    assert observation.endswith("\n[/app · the last turn]")
    observation, reward, terminated, truncated, info = env.step("<bash>touch done</bash>")
    assert observation == "ran touch done\n[exit code 0]\nThe tests have passed."
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    env.close()


def test_agent_out_of_time_is_judged(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """What it did counts; what it says too late is not done."""
    env = make(monkeypatch, script, agent_timeout_s=0.000001)
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step("<bash>late</bash>")
    assert observation == "Your time is over: this was not done any more.\nThe tests have passed."
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert info["terminal"]["ended_by"] == "agent_timeout"
    assert script.limits == []
    env.close()


def test_episode_out_of_time_is_a_failure_of_the_agent(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """Nothing is verified any more, the machine is gone, and it is no error."""
    env = make(monkeypatch, script, episode_timeout_s=0.000001)
    env.reset(seed=1)
    _, reward, terminated, truncated, info = env.step("<bash>late</bash>")
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert info["terminal"]["ended_by"] == "episode_timeout"
    assert "error" not in info
    assert script.verified == []
    env.close()


def test_machine_is_removed_when_the_time_of_the_episode_is_over(
    monkeypatch: pytest.MonkeyPatch, script: Script
) -> None:
    """Though the agent never comes back."""
    env = make(monkeypatch, script, episode_timeout_s=0.2)
    env.reset(seed=1)
    deadline = time.monotonic() + 30
    while script.backend.live and time.monotonic() < deadline:
        pass
    assert script.backend.live == {}
    assert env.step("<bash>late</bash>")[2] is True
    env.close()


def test_limits_of_commands_nest(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """A command's is the one asked for, but no more than may be asked for, and than the agent has left."""
    env = make(monkeypatch, script, command_timeout_s=10, most_command_timeout_s=20, agent_timeout_s=1000)
    env.reset(seed=1)
    for words in ("<bash>a</bash>", '<bash timeout="15">a</bash>', '<bash timeout="500">a</bash>'):
        env.step(words)
    assert script.limits == [10, 15, 20]
    env.close()
    short = make(monkeypatch, script, agent_timeout_s=5)
    short.reset(seed=1)
    short.step("<bash>a</bash>")
    assert 0 < script.limits[-1] <= 5
    short.close()


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


@pytest.mark.parametrize("by_agent", [True, False, None])
def test_lost_machine(env: TerminalEnv, script: Script, by_agent: bool | None) -> None:
    """The agent's doing is scored; anything else, and what is not known, is an error."""
    env.reset(seed=1)

    def lose(command: str, limit: float) -> Any:
        raise MachineLostError("its memory was full", by_agent=by_agent)

    script.on_run = lose
    observation, reward, terminated, truncated, info = env.step("<bash>eat</bash>")
    assert reward == 0.0
    if by_agent:
        assert (terminated, truncated, info["correct"]) == (True, False, False)
        assert observation == "The machine is lost: its memory was full"
    else:
        assert (terminated, truncated) == (False, True)
        assert info["error"] == {"kind": "machine", "message": "its memory was full"}
    with pytest.raises(ResetNeededError, match="call reset"):
        env.step("<bash>ls</bash>")


def test_machine_that_ended_before_the_first_action_is_an_error(
    env: TerminalEnv, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The agent has done nothing, whatever it looks like; later, it may have."""
    lost = MachineLostError("its first process was ended", by_agent=True)
    env.reset(seed=1)
    monkeypatch.setattr(MemoryMachine, "why_lost", lambda machine: lost)
    _, reward, terminated, truncated, info = env.step("<finish/>")
    assert (reward, terminated, truncated) == (0.0, False, True)
    said = "its first process was ended, before the agent did anything"
    assert info["error"] == {"kind": "machine", "message": said}
    assert script.verified == []


def test_engine_that_fails_is_an_error_whatever_the_agent_did(
    env: TerminalEnv, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the step; one of the reset is raised, and leaves no machine."""

    def fail(*_: Any, **__: Any) -> Any:
        raise EngineError("no engine; start one")

    env.reset(seed=1)
    script.on_run = fail
    _, _, terminated, truncated, info = env.step("<bash>ls</bash>")
    assert (terminated, truncated) == (False, True)
    assert info["error"] == {"kind": "engine", "message": "no engine; start one"}
    script.backend.on_start = fail
    with pytest.raises(EngineError):
        env.reset(seed=1)
    script.backend.on_start = None
    assert env.reset(seed=1)[1]["task_id"]
    monkeypatch.setattr(episode, "Shell", fail)
    with pytest.raises(EngineError):
        env.reset(seed=1)
    env.close()
    assert script.backend.live == {}


def test_native_calls_are_answered_under_their_ids(env: TerminalEnv) -> None:
    """The first is executed, the others are told that they were not."""
    env.reset(seed=1)
    calls = [
        {"id": name, "type": "function", "function": {"name": "bash", "arguments": json.dumps({"command": name})}}
        for name in ("a", "b")
    ]
    observation, _, _, _, info = env.step(gem.Response("", tool_calls=calls))
    assert observation.startswith("ran a")
    assert [message["tool_call_id"] for message in info["messages"]] == ["a", "b"]
    assert info["messages"][0] == {"role": "tool", "tool_call_id": "a", "content": observation}
    assert info["messages"][1]["content"].startswith("Not done")


def test_seed_chooses_the_task_and_options_overrule_it(env: TerminalEnv) -> None:
    """The same seed gives the same task; an index or a name takes that one."""
    drawn = [env.reset(seed=seed)[1]["task_id"] for seed in range(12)]
    assert drawn == [env.reset(seed=seed)[1]["task_id"] for seed in range(12)]
    assert set(drawn) == {"one", "two", "three"}
    assert [env.reset(options={"index": index})[1]["task_id"] for index in range(3)] == ["one", "two", "three"]
    assert env.num_tasks == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "twoo"}, "there is no task 'twoo' among 3. Did you mean 'two'?"),
        ({"index": 3}, r"options\['index'\] must be from 0 to 2, not 3"),
        ({"index": True}, "not True"),
        ({"tusk": "one"}, "Did you mean 'task'?"),
        ({"task": "one", "index": 0}, "expected one of task and index"),
    ],
)
def test_wrong_options(env: TerminalEnv, options: dict[str, Any], words: str) -> None:
    """The message says what there is."""
    with pytest.raises(ArgumentError, match=words):
        env.reset(options=options)


WRONG = {"reward": "most", "agent_timeout_s": "tusk", "episode_timeout_s": -1, "max_turns": 0, "max_malformed": 1.5}
WRONG |= {"malformed_penalty": "none", "max_output": 1, "cpus": 0, "memory_mb": True, "network": "some"}
WRONG |= {"verify_in": "auto", "artifacts": ["out"], "pool_size": -1, "weights": {"a": -1}, "columns": 5}


@pytest.mark.parametrize(
    ("name", "value"), [*WRONG.items(), ("command_timeout_s", 0), ("command_timeout_s", float("nan")), ("backend", "x")]
)
def test_wrong_values_are_refused(monkeypatch: pytest.MonkeyPatch, script: Script, name: str, value: Any) -> None:
    """At once, by name."""
    monkeypatch.setattr(script, "backend", value) if name == "backend" else None
    with pytest.raises(ArgumentError, match=rf"^{name} "):
        make(monkeypatch, script, **({} if name == "backend" else {name: value}))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, (-5.0, 1.0)),
        ({"malformed_penalty": 0.5, "max_turns": 4}, (0.0, 3.0)),
        ({"max_turns": None}, None),
        ({"reward": "score"}, None),
    ],
)
def test_return_range_is_declared_where_rewards_bound_it(
    monkeypatch: pytest.MonkeyPatch, script: Script, options: Any, expected: Any
) -> None:
    """Of the verdict, and of as many malformed responses as there are turns."""
    assert make(monkeypatch, script, **options).return_range == expected


def test_running_machine_cannot_be_forked(env: TerminalEnv) -> None:
    env.reset(seed=1)
    with pytest.raises(StateNotSupported, match="a running machine cannot be copied"):
        env.fork()


def test_sampled_actions_are_valid_and_end_in_time(env: TerminalEnv) -> None:
    """They are the same for the same seed, and change nothing of the episode."""
    env.reset(seed=1)
    first = [env.sample_random_action() for _ in range(50)]
    env.reset(seed=1)
    assert [env.sample_random_action() for _ in range(50)] == first
    assert "<finish/>" in first
    assert all(action == "<finish/>" or action.startswith("<bash>") for action in first)


def test_close_is_idempotent_and_the_environment_can_be_used_again(env: TerminalEnv, script: Script) -> None:
    """Nothing is left after each."""
    env.reset(seed=1)
    env.close()
    env.close()
    assert script.backend.live == {}
    env.reset(seed=1)
    assert len(script.backend.live) == 1


def test_pool_makes_the_next_machine_ready(monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """And close removes it."""
    env = make(monkeypatch, script, [plain_task("only")], pool_size=2, prestart=True)
    for _ in range(3):
        env.reset()
    deadline = time.monotonic() + 60
    while len(script.backend.made) < 5:
        assert time.monotonic() < deadline
    env.close()
    assert script.backend.live == {}


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


def test_info_has_no_path_of_this_machine(env: TerminalEnv) -> None:
    """Neither the folder of the task nor that of the program."""
    _, info = env.reset(seed=1)
    *_, last = env.step("<finish/>")
    text = json.dumps([info, last])
    assert "/nowhere" not in text
    assert str(Path.home()) not in text.replace('"/root"', "")
