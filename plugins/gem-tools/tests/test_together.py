"""Tools side by side: one task, several turns, search for what is needed and Python for what follows from it."""

from __future__ import annotations

import json
from typing import Any

import pytest

import gem_core as gem

QUESTION = "How many kilometres a day did the raft Kon-Tiki make on average, rounded to a whole number?"
gem.register("raft:Speed-v0", "gem_core:DatasetEnv", rows=[{"question": QUESTION, "answer": "68"}])


def searching_agent(observation: Any, context: Any) -> gem.Response | str:
    """Look the voyage up, name an argument wrongly, compute, and answer with what was computed."""
    text = str(observation)
    if context.turn == 0:
        return "<think>I might <python>guess</python>.</think> <search>Kon-Tiki raft</search>"
    if context.turn == 1:
        return '<tool_call>{"name": "python", "arguments": {"source": "round(6900 / 101)"}}</tool_call>'
    if context.turn == 2:
        facts = text.split("Output of search:")[1]
        days = facts.split("After ")[1].split(" days")[0]
        length = facts.split("about ")[1].split(" kilometres")[0].replace(",", "")
        code = f"round({length} / {days})"
        return f"<tool_call>{json.dumps({'name': 'python', 'arguments': {'code': code}})}</tool_call>"
    return "\\boxed{" + text.rsplit("Output of python:", 1)[1].split()[0] + "}"


@pytest.mark.parametrize("backend", ["sync", "async"])
@pytest.mark.parametrize("wrappers", ["python,search,concat", "python,concat,search"])
def test_a_task_is_solved_in_several_turns_with_two_tools(backend: str, wrappers: str) -> None:
    """They share one budget and one explanation, wherever they stand; the call that was malformed is told."""
    vector = gem.make_vec("raft:Speed-v0", backend=backend, wrappers=wrappers)
    try:
        (episode,) = gem.rollout(vector, searching_agent, episodes=1)
    finally:
        vector.close()
    assert episode.success
    assert episode.tools == ["python", "search"]
    assert str(episode.observation).count("You may use tools before you answer.") == 1
    used = [turn.info["tool"] for turn in episode.transitions[:-1]]
    assert [(tool["name"], tool["failed"], tool["uses"]) for tool in used] == [
        ("search", False, 1),
        ("python", True, 2),
        ("python", False, 3),
    ]
    assert "code: Field required" in str(episode.transitions[2].observation)
