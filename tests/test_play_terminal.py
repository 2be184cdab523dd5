"""``gem play`` in a terminal: prompt, colours, Ctrl-C and Ctrl-D."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gem_core.records.files import read_episodes
from gem_core.terminal import BLOCK

COUNTDOWN, ECHO, SUMS = "toy:Countdown-v0", "toy:Echo-v0", "toy:Sums-v0"
COLOUR = re.compile(r"\x1b\[[\d;]*m")


def test_prompt_colours_and_another_episode(terminal, tmp_path: Path) -> None:
    """Asked after each episode; the file holds both."""
    session = terminal("play", SUMS, "--out", "a.jsonl")
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("reward 1")
    session.wait_for("Play another? [Y/n]")
    session.type("\n")
    session.wait_for("turn 1> ")
    session.type("9\n")
    session.wait_for("Play another? [Y/n]")
    session.type("n\n")
    session.wait_for("2 episodes written to a.jsonl.")
    assert session.end() == 0
    assert [episode.episode_return for episode in read_episodes(tmp_path / "a.jsonl")] == [1.0, 0.0]


@pytest.mark.parametrize("setting", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
@pytest.mark.few(1)
def test_no_colours_where_they_are_not_wanted(terminal, setting: dict[str, str]) -> None:
    """The prompt is there all the same."""
    session = terminal("play", SUMS, **setting)
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("Play another? [Y/n]")
    session.type("n\n")
    assert session.end() == 0
    assert not COLOUR.search(session.output)


def test_long_lines_are_broken_between_words(terminal) -> None:
    """At the width of the terminal, which here says none, or at 100 columns."""
    session = terminal("play", ECHO)
    session.wait_for("turn 1> ")
    session.type(f"{BLOCK}\n{'word ' * 60}\n{BLOCK}\n")
    session.wait_for("return 0")
    session.wait_for("turn 2> ")
    session.type("\x04")
    assert session.end() == 0
    shown = COLOUR.sub("", session.output).partition("return 0")[2]
    lines = [line for line in shown.split("\n") if line.startswith(("Heard: ", "word"))]
    assert len(lines) > 1
    assert all(len(line) <= 100 and line.endswith("word") for line in lines)


def test_ctrl_c_ends_with_what_was_finished(terminal, tmp_path: Path) -> None:
    """Exit code 130, one line, no traceback."""
    session = terminal("play", SUMS, "-n", "2", "-o", "a.jsonl")
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("turn 1> ")
    session.type("\x03")
    session.wait_for("\n\x1b[33mLeft unfinished after 0 turns, return 0; it is not recorded.")
    session.wait_for("1 episode written to a.jsonl.")
    session.wait_for("gem: interrupted")
    assert session.end() == 130
    assert "Traceback" not in session.output
    assert len(list(read_episodes(tmp_path / "a.jsonl"))) == 1


def test_ctrl_d_ends_politely(terminal) -> None:
    """Exit code 0, at the prompt and at the question."""
    session = terminal("play", COUNTDOWN)
    session.wait_for("turn 1> ")
    session.type("\x04")
    session.wait_for("Left unfinished after 0 turns, return 0.")
    assert session.end() == 0
    session = terminal("play", SUMS)
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("Play another? [Y/n]")
    session.type("\x04")
    assert session.end() == 0
