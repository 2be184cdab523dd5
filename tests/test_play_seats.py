"""``gem play`` at one seat among several agents."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_calls import Outcome, RunGem

import gem_core as gem

HEAP, AUCTION, ALONE = "playseats:Countdown-v0", "playseats:Auction-v0", "playseats:Alone-v0"

Play = Callable[..., Outcome]

TAKER = r"""
def one(observation):
    return "\\boxed{1}"
"""


@pytest.fixture
def play(run_gem: RunGem, monkeypatch: pytest.MonkeyPatch) -> Play:
    """Call ``gem play`` in this process, in an empty folder, with input from a pipe."""
    if HEAP not in gem.list_envs():
        gem.register(HEAP, "joint_toys:CountdownEnv", seats=("first", "second"), summary="Take the last.")
        gem.register(AUCTION, "joint_toys:AuctionEnv", agents=["a", "b", "c"], rounds=6, seats=("a", "b", "c"))
        gem.register(ALONE, "toys:CountdownEnv")
    Path("play_takers.py").write_text(TAKER)

    def call(*arguments: str, typed: str = "") -> Outcome:
        monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
        return run_gem("play", *arguments)

    return call


def test_person_has_the_first_seat_against_a_random_agent(play: Play) -> None:
    """The summary names the seats, an answer gets its form, and a loss is one; the record says who sat where."""
    outcome = play(HEAP, "--seed", "1", "--out", "a.jsonl", typed="1\n" * 9)
    assert (outcome.code, outcome.err) == (0, "")
    assert "Take the last. Your seat is first; the others are second=random.\n" in outcome.out
    (episode,) = gem.read_episodes("a.jsonl")
    assert (episode.id, episode.seat, episode.agent) == (HEAP, "first", "human")
    assert episode.kwargs == {"seat": "first", "others": {"second": "random"}}
    assert {turn.action for turn in episode.transitions} == {"\\boxed{1}"}
    ending = "Won" if episode.success else "Lost"
    assert f"{ending} after {episode.turns} turns. Return {episode.episode_return:g}.\n" in outcome.out


def test_person_chooses_the_seat_and_the_others(play: Play) -> None:
    """By seat, where seats that are left out are random, or one agent for all others; a turn can be taken back."""
    by_seat = play(AUCTION, "--seat", "b", "--agent", "c=play_takers:one", typed="3\nquit\n")
    assert "Your seat is b; the others are a=random, c=play_takers:one.\n" in by_seat.out
    for_all = play(AUCTION, "--seat", "b", "--agent", "play_takers:one", typed="3\n!undo\n4\nquit\n")
    assert "the others are a=play_takers:one, c=play_takers:one.\n" in for_all.out
    assert "You are b. Bids: 0 4 0 0\n" in for_all.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([HEAP, "--seat", "frst"], f"{HEAP} has no seat 'frst'. Did you mean 'first'? Its seats are first, second"),
        ([HEAP, "--agent", "first=random"], f"the seat first of {HEAP} is yours: "),
        ([AUCTION, "--agent", "random", "--agent", "c=random"], "write --agent b=AGENT --agent c=AGENT"),
        ([ALONE, "--seat", "first"], f"{ALONE} is for one agent: leave --seat out"),
    ],
)
def test_seats_that_do_not_fit_are_refused(play: Play, arguments: list[str], message: str) -> None:
    """In one line that names the seats."""
    outcome = play(*arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert message in outcome.err
