"""The agent ``human``: a person, or a pipe, answers a run; and the form into which plain answers are put."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import pytest

from gem_core.agents import AnswerForm
from gem_core.cli import main
from gem_core.records.files import read_episodes

SUMS = "toy:Sums-v0"


def test_human_answers_a_run_in_a_terminal(terminal, tmp_path: Path) -> None:
    """One environment, without being asked; no bar that overwrites the prompt; plain answers in their form."""
    session = terminal("run", SUMS, "--agent", "human", "-n", "2", "-o", "a.jsonl")
    session.wait_for("episode 1 · turn 1")
    session.wait_for("0+1")
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("reward 1 · return 1, and the episode is over")
    session.wait_for("turn 1> ")
    session.type("?\n")
    session.wait_for("The form of an answer: \\boxed{…}")
    session.wait_for("turn 1> ")
    session.type("!nothing\n")
    session.wait_for("There are: !help, !random, !quit")
    session.wait_for("turn 1> ")
    session.type("!random\n")
    session.wait_for("2 episodes in ")
    assert session.end() == 0
    actions = [str(episode.transitions[0].action) for episode in read_episodes(tmp_path / "a.jsonl")]
    assert actions[0] == "\\boxed{1}"
    assert re.fullmatch(r"\\boxed\{\d\}", actions[1])
    assert "━━━ " not in session.output.partition("2 episodes in ")[0].partition("environment")[0]


@pytest.mark.parametrize(
    ("typed", "options", "code", "last_error"),
    [
        ("1\n3\n", ("-n", "2", "--json"), 0, "1+1"),  # shown on standard error, so that a machine can read the table
        ("1\n", ("-n", "2"), 1, "ended while episode 2 of toy:Sums-v0 waited for the answer of turn 1; run it in a"),
        ("1\n", ("-k", "3"), 2, "answers one episode at a time; use --num-envs 1, not 3"),
    ],
)
def test_human_reads_a_pipe(monkeypatch, capsys, tmp_path, typed, options, code, last_error) -> None:
    """Without a prompt; an input that ends too early is named."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(typed.encode())))
    with pytest.raises(SystemExit) as caught:
        main(["run", SUMS, "-a", "human", *options])
    shown = capsys.readouterr()
    assert (caught.value.code or 0) == code
    assert last_error in shown.err.splitlines()[-1]
    assert "turn 1>" not in shown.out + shown.err
    assert "0+1" not in shown.out


@pytest.mark.parametrize(
    ("example", "typed", "sent"),
    [
        (r"I guess \boxed{1 2}.", "3 4", r"\boxed{3 4}"),
        ("<think>hm</think><answer>yes</answer>\n", "no", "<answer>no</answer>"),
        (r"<answer>\boxed{1}</answer>", "2", r"<answer>\boxed{2}</answer>"),
        ("```python\nprint(1)\n```", "print(2)", "```python\nprint(2)\n```"),
        ("so:\n```\nls\n```", "pwd", "```\npwd\n```"),
        ("<bash>ls</bash>", "cat <b>", "<bash>cat <b></bash>"),
        ("[A]", "[B]", "[B]"),
        ("go</north>", "go", "go"),
        ('<tool_call>{"name": "search"}</tool_call>', "Hello.", "Hello."),  # shows no form of an answer
    ],
)
def test_an_answer_is_put_into_the_form_of_the_example(example: str, typed: str, sent: str) -> None:
    """A box, a tag, a box in a tag, a fenced block, or nothing."""
    assert AnswerForm.of_example(example).around(typed) == sent


@pytest.mark.parametrize(
    ("example", "typed"),
    [
        (r"\boxed{3}", r"it is \boxed{4"),
        (r"\boxed{3}", "I say <answer>4</answer>"),
        ("<answer>3</answer>", r"\boxed{4}"),
        ("<move>3</move>", "I go <move>4"),
        ("<bash>ls</bash>", ' <keys wait="3">q</keys>'),
        ("```python\n1\n```", "~~~\n2\n~~~"),
        (r"\boxed{3}", '<tool_call>{"name": "search"}</tool_call>'),
    ],
)
def test_what_is_in_a_form_already_is_left_alone(example: str, typed: str) -> None:
    """Also where the form is begun and not complete: the environment has to see the mistake."""
    assert AnswerForm.of_example(example).around(typed) == typed
