"""RockPaperScissors: both seats at once, several rounds, and best responses."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_games.rock_paper_scissors import MOVES, RockPaperScissorsEnv, best_response


def chosen(left: str, right: str) -> dict[str, str]:
    return {"left": f"\\boxed{{{left}}}", "right": f"\\boxed{{{right}}}"}


@pytest.mark.parametrize("left", MOVES)
@pytest.mark.parametrize("right", MOVES)
def test_round_is_won_lost_and_drawn(left: str, right: str) -> None:
    """All nine, and a draw is no win of either."""
    beats = {("rock", "scissors"), ("scissors", "paper"), ("paper", "rock")}
    reward = float((left, right) in beats) - float((right, left) in beats)
    env: Any = gem.make("game:RockPaperScissors-v0")
    assert set(env.reset(seed=0)[0]) == {"left", "right"}
    _, rewards, terminations, _, infos = env.step(chosen(left.upper(), right))
    assert rewards == {"left": reward, "right": -reward}
    assert terminations == {"left": True, "right": True}
    assert [infos[seat]["correct"] for seat in ("left", "right")] == [reward > 0, reward < 0]


def test_rounds_are_rewarded_one_by_one() -> None:
    """Who won more rounds has won; the rounds so far stand in each observation, each seat's own choice first."""
    env: Any = gem.make("game:RockPaperScissors-v0", rounds=3)
    env.reset(seed=0)
    observations, rewards, *_ = env.step(chosen("rock", "scissors"))
    assert rewards == {"left": 1.0, "right": -1.0}
    assert observations["right"] == (
        "You chose scissors, the other player rock: the round is lost.\n"
        "Rounds so far, your choice first: scissors-rock.\n"
        "Round 2 of 3. Answer \\boxed{rock}, \\boxed{paper} or \\boxed{scissors}."
    )
    env.step(chosen("rock", "paper"))
    _, rewards, _, _, infos = env.step(chosen("paper", "paper"))
    assert rewards == {"left": 0.0, "right": 0.0}
    assert infos["left"]["final_obs"].endswith("The game is over: it is a draw.")
    assert infos["left"]["correct"] is False


def test_forfeit_loses_all_rounds() -> None:
    """Also those that were won; if both forfeit at once, nobody wins."""
    env: Any = gem.make("game:RockPaperScissors-v0", rounds=3)
    env.reset(seed=0)
    env.step(chosen("rock", "scissors"))
    env.step(chosen("no", "rock"))
    env.step({"left": "no"})
    _, rewards, _, _, infos = env.step({"left": "no"})
    assert rewards == {"left": -4.0, "right": 4.0}
    assert env.cumulative == {"left": -3.0, "right": 3.0}
    assert infos["right"]["correct"] is True
    env.reset(seed=0)
    for _ in range(3):
        _, rewards, *_ = env.step({"left": "no", "right": "no"})
    assert rewards == {"left": 0.0, "right": 0.0}
    assert env.agents == []


def test_best_response_beats_what_is_most_likely() -> None:
    """And gets nothing against a third each."""
    third = Fraction(1, 3)
    assert best_response({"rock": 1})[:2] == ("paper", 1)
    assert best_response({"rock": Fraction(1, 2), "paper": Fraction(1, 4), "scissors": Fraction(1, 4)}) == (
        "paper",
        Fraction(1, 4),
    )
    assert best_response(dict.fromkeys(MOVES, third))[1] == 0


@pytest.mark.parametrize("rounds", [0, 101, 2.0, True, None])
def test_rounds_are_checked(rounds: Any) -> None:
    with pytest.raises(ArgumentError, match="rounds"):
        RockPaperScissorsEnv(rounds)
