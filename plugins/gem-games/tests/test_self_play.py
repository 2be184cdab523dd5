"""The games of several agents in rollouts: self-play without an error, every reward recorded, known values."""

from __future__ import annotations

import math
import statistics

import pytest

import gem_core as gem
from gem_core.testing import check_env

GAMES = [record for record in gem.list_envs("game") if gem.spec(record).seats]


@pytest.mark.parametrize("env_id", GAMES)
def test_random_self_play_accounts_for_every_reward(env_id: str, many: int) -> None:
    """Every game ends by itself, without an error, and the returns are what the rules pay."""
    for joint in gem.rollout(env_id, agents="random", episodes=many, seed=11):
        assert joint.error is None
        assert all(episode.cut_off is None for episode in joint)
        assert list(joint.seats) == list(gem.spec(env_id).seats)
        if env_id != "game:Negotiation-v0":  # there is something to gain together
            assert sum(joint.returns.values()) == 0.0


def test_equilibrium_of_kuhn_poker_loses_an_eighteenth_for_the_first_seat(many: int) -> None:
    """The mean return of the first seat is that of theory, within four standard errors of this sample."""
    played = gem.rollout("game:KuhnPoker-v0", agents="kuhn", episodes=100 * many, seed=1)
    returns = [joint.returns["first"] for joint in played]
    error = statistics.stdev(returns) / math.sqrt(len(returns))
    assert abs(statistics.mean(returns) + 1 / 18) < 4 * error
    assert error < 2 / math.sqrt(len(returns))


def test_perfect_players_of_tic_tac_toe_always_draw() -> None:
    """Self-play of the solver ends in draws, and it never loses from either seat against random play."""
    assert {
        joint.returns["X"] for joint in gem.rollout("game:TicTacToe-v0", agents="tictactoe", episodes=10, seed=3)
    } == {0}
    for joint in gem.rollout("game:TicTacToe-v0", agents=["tictactoe", "random"], episodes=20, seed=3):
        seat = next(seat for seat, agent in joint.agents.items() if agent == "tictactoe")
        assert joint.returns[seat] >= 0


@pytest.mark.few(1)
@pytest.mark.parametrize("env_id", GAMES)
def test_games_of_several_keep_the_contract(env_id: str) -> None:
    """Determinism, state, hostile text from every seat, accounting: everything that ``check_env`` tries."""
    report = check_env(env_id)
    assert {"turns", "leaving", "accounting", "refused-actions", "reasoning"} <= set(report.kept)
