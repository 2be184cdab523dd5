"""``gold_action`` of games: it wins, for audits."""

from __future__ import annotations

import pytest

import gem_core as gem

GAMES = ["GuessTheNumber", "Hangman", "Wordle", "Mastermind", "Sudoku", "Crosswords", "WordSearch", "TowerofHanoi"]


@pytest.mark.parametrize("name", [*GAMES, "WikiGame"])
def test_gold_actions_win(name: str) -> None:
    """Played turn by turn, also after a random action, they win within the turns that there are."""
    env = gem.make(f"game:{name}-v0-random")
    for seed in range(3):
        env.reset(seed=seed)
        _, _, over, _, info = env.step(env.sample_random_action())
        while not over:
            _, _, over, _, info = env.step(env.gold_action())
        assert info["correct"]
        assert env.gold_action() is None
