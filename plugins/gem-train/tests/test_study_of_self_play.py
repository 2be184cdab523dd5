"""The study of self-play: what it measures, and a run of a few updates."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")

import torch

from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.training import Training, warm_start
from gem_train.learner.vocabulary import Vocabulary
from gem_train.studies import self_play

WORDS = "\\boxed{bet}\\boxed{check}\\boxed{call}\\boxed{fold}"
MOVES = {False: ("bet", "check"), True: ("call", "fold")}
TINY: dict[str, Any] = {
    "updates": 1,
    "episodes": 4,
    "imitate_steps": 2,
    "eval_episodes": 8,
    "width": 8,
    "heads": 2,
}


def tiny(game: str, **options: Any) -> Training:
    """A policy that has learnt nothing."""
    chosen = {"env": (f"game:{game}-v0",), "memory": 0, "context": 24, "max_tokens": 6, **TINY, **options}
    return Training(Learner(TrainOptions(**chosen), Vocabulary.build([WORDS])))


def test_decisions_of_kuhn_poker_are_shown_as_they_are() -> None:
    """Each of the 12 has a text of its own, that names the card and the moves that are possible."""
    shown = self_play.information_sets()
    assert len(shown) == len(set(shown.values())) == 12
    for (card, history), text in shown.items():
        move, other = MOVES[history[-1:] == ("bet",)]
        assert f"hold the {card}." in text
        assert text.endswith(f"Answer \\boxed{{{move}}} or \\boxed{{{other}}}.") or text.endswith(
            f"Answer \\boxed{{{other}}} or \\boxed{{{move}}}."
        )


def test_even_policy_is_as_exploitable_as_known() -> None:
    """With equal logits both moves are as likely; the best response to that wins 11/24 of a chip over both seats."""
    with tiny("KuhnPoker") as training:
        torch.nn.init.zeros_(training.learner.policy.unembedding.weight)
        measured = self_play.measure_kuhn(training)
    assert set(measured["chips"].values()) == {0.5}
    assert measured["exploitability"] == pytest.approx(11 / 24)


def test_strategy_is_what_the_policy_says() -> None:
    """A policy that nearly always calls, and bets as often as it checks, does so in the strategy that is measured."""
    with tiny("KuhnPoker") as training:
        learner = training.learner
        weight = torch.nn.init.zeros_(learner.policy.unembedding.weight)
        (call,), (fold,) = (learner.vocabulary.encode(move, phrases=False) for move in ("call", "fold"))
        learner.policy.norm.bias.data[0] = 1.0
        weight.data[call, 0], weight.data[fold, 0] = 5.0, -5.0
        learner.policy.norm.weight.data.zero_()
        strategy, _ = self_play.kuhn_strategy(learner)
    for (_, history), chip in strategy.items():
        assert float(chip) == pytest.approx(1.0 if history[-1:] == ("bet",) else 0.5, abs=1e-3)


def test_games_against_the_perfect_player_are_counted() -> None:
    """A policy whose answers cannot be read loses every game by forfeit, at both seats."""
    with tiny("TicTacToe") as training:
        measured = self_play.measure_tictactoe(training)
        again = self_play.measure_tictactoe(training)
    assert measured == again == {"lost": 1.0, "drawn": 0.0, "won_against_random": 0.0}


def test_rewards_of_self_play_add_up_to_nothing() -> None:
    """What one seat wins the other loses, and each has it in its last turn, or before its first."""
    options = self_play.options_of("KuhnPoker", True, 0)
    learner = warm_start(replace(options, episodes=64, imitate_episodes=100, imitate_steps=40, learning_rate=1e-6))
    with Training(learner) as training:
        played = training.update().played
    games: dict[int, list[Any]] = {}
    for seat in played:
        games.setdefault(seat.slot, []).append(seat)
    assert len(games) == 64
    for game in games.values():
        assert sum(seat.episode_return for seat in game) == 0
        last = [
            seat.turns[-1].reward if seat.turns else seat.first_reward for seat in game
        ]  # no turn: it had won first
        assert last == [seat.episode_return for seat in game]
        assert all(abs(seat.episode_return) in (1, 2) for seat in game)


@pytest.mark.thorough
def test_study_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tiny study from the warm start to its page; a row for each game, with and without baselines."""
    monkeypatch.setattr(self_play, "GAMES", {game: {**options, **TINY} for game, options in self_play.GAMES.items()})
    rows = self_play.run(tmp_path, quick=True, seeds=1, workers=1, quiet=True)
    assert [(row["game"], row["measure"], row["baselines"]) for row in rows] == [
        ("KuhnPoker", "exploitability", True),
        ("KuhnPoker", "exploitability", False),
        ("KuhnPoker", "mean_exploitability", True),
        ("KuhnPoker", "mean_exploitability", False),
        ("TicTacToe", "lost", True),
        ("TicTacToe", "lost", False),
        ("TicTacToe", "won_against_random", True),
        ("TicTacToe", "won_against_random", False),
    ]
    assert rows[0]["start"] == rows[2]["start"] > 0
    assert all(row["low"] is None for row in rows)
    json.dumps(rows)
    assert {path.name for path in tmp_path.glob("*.png")} == {"kuhn.png", "tictactoe.png"}
    assert "KuhnPoker" in (tmp_path / "index.html").read_text()
