"""``gem play`` in a terminal: prompt, colours, Ctrl-C and Ctrl-D."""

from __future__ import annotations

from pathlib import Path

from gem_core.records.files import read_episodes

SUMS = "toy:Sums-v0"


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


def test_ctrl_c_ends_with_what_was_finished(terminal, tmp_path: Path) -> None:
    """Exit code 130, one line, no traceback."""
    session = terminal("play", SUMS, "-n", "2", "-o", "a.jsonl")
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("turn 1> ")
    session.type("\x03")
    session.wait_for("\n\x1b[33mLeft unfinished after 0 turns.")
    session.wait_for("1 episode written to a.jsonl.")
    session.wait_for("gem: interrupted")
    assert session.end() == 130
    assert "Traceback" not in session.output
    assert len(list(read_episodes(tmp_path / "a.jsonl"))) == 1


def test_ctrl_d_ends_politely(terminal) -> None:
    """Exit code 0, at the question too."""
    session = terminal("play", SUMS)
    session.wait_for("turn 1> ")
    session.type("1\n")
    session.wait_for("Play another? [Y/n]")
    session.type("\x04")
    assert session.end() == 0
