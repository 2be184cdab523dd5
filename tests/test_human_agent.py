"""The agent ``human``: a person, or a pipe, answers a run."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import pytest

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
    session.wait_for("no command '!nothing'. There are: !help, !random, !quit, and ?")
    session.wait_for("turn 1> ")
    session.type("!random\n")
    session.wait_for("2 episodes in ")
    assert session.end() == 0
    actions = [str(episode.transitions[0].action) for episode in read_episodes(tmp_path / "a.jsonl")]
    assert actions[0] == "\\boxed{1}"
    assert re.fullmatch(r"\\boxed\{\d\}", actions[1])
    assert "━━━ " not in session.output.partition("2 episodes in ")[0].partition("environment")[0]


def piped(monkeypatch: pytest.MonkeyPatch, typed: str, *arguments: str) -> int:
    """Call ``gem run`` in this process, with input from a pipe."""
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(typed.encode())))
    with pytest.raises(SystemExit) as caught:
        main(["run", *arguments])
    return int(caught.value.code or 0)


def test_human_reads_a_pipe(monkeypatch, capsys, tmp_path: Path) -> None:
    """What is shown goes to standard error, so that the table can be read by a machine."""
    monkeypatch.chdir(tmp_path)
    assert piped(monkeypatch, "1\n3\n", SUMS, "-a", "human", "-n", "2", "--json") == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("{")
    assert "──── toy:Sums-v0 · episode 2 · turn 1 ────\n1+1\n" in captured.err
    assert ">" not in captured.err


def test_human_without_input_says_where_to_run_it(monkeypatch, capsys, tmp_path: Path) -> None:
    """In one line, behind the table; an input that ends too early is named as such."""
    monkeypatch.chdir(tmp_path)
    assert piped(monkeypatch, "", SUMS, "-a", "human", "-n", "2") == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "gem: the agent 'human' reads standard input, which ended while episode 1 of toy:Sums-v0 waited for the "
        "answer of turn 1; run it in a terminal"
    )
    assert piped(monkeypatch, "1\n", SUMS, "-a", "human", "-n", "2") == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "gem: the input ended while episode 2 of toy:Sums-v0 waited for the answer of turn 1"
    )


def test_human_answers_one_episode_at_a_time(monkeypatch, capsys, tmp_path: Path) -> None:
    """More environments at once would mix their turns."""
    monkeypatch.chdir(tmp_path)
    assert piped(monkeypatch, "1\n", SUMS, "-a", "human", "-k", "3") == 2
    assert capsys.readouterr().err == (
        "gem: the agent 'human' answers one episode at a time; use --num-envs 1, not 3\n"
    )
