"""The studies in examples/paper: their tasks, what they measure, and a tiny run of each."""

from __future__ import annotations

import importlib
import sys
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import gem_core as gem
from gem_core.rollouts import Context
from gem_core.testing import check_env

pytest.importorskip("torch")
pytest.importorskip("gem_games")

import torch

from gem_train.learner.imitation import record_episodes
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.playing import text_of
from gem_train.learner.training import Training, warm_start
from gem_train.learner.vocabulary import Vocabulary

FOLDER = Path(__file__).parents[3] / "examples" / "paper"
if not FOLDER.exists():
    pytest.skip("the examples are not in this distribution", allow_module_level=True)

TINY: dict[str, Any] = {"updates": 1, "episodes": 8, "eval_episodes": 12, "width": 8, "heads": 2}
TINY |= {"imitate_episodes": 12, "imitate_steps": 2}


def script(name: str) -> ModuleType:
    sys.path.insert(0, str(FOLDER))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(FOLDER))


rewards, algorithms, self_play = script("rewards"), script("algorithms"), script("self_play")


@pytest.mark.parametrize(
    ("name", "rows", "ends"),
    [
        ("rewards", 6, ("success", "with_tool")),
        ("transfer", 8, ("imitation", "success")),
        ("algorithms", 6, ("success", "random")),
        ("self_play", 10, ("start", "end")),
    ],
)
def test_study_runs_from_imitation_to_its_figure(
    name: str, rows: int, ends: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the smallest size, in this process; one seed has no interval."""
    for needed in ("gem_tools", "reasoning_gym"):
        pytest.importorskip(needed)
    study, printed = script(name), []
    options_of = study.options_of
    monkeypatch.setattr(study, "options_of", lambda *given: replace(options_of(*given), **TINY))
    monkeypatch.setattr(study, "RANDOM_EPISODES", 8, raising=False)
    monkeypatch.setattr(
        study, "run_all", lambda run, settings, *_, **__: [{**each, **run(**each)} for each in settings]
    )
    monkeypatch.setattr(study, "print_rows", printed.extend)
    monkeypatch.setattr(sys, "argv", [name, "--quick", "--out", str(tmp_path)])
    study.main()
    assert len(printed) == rows
    assert all(isinstance(row[end], float) for row in printed for end in ends)
    assert {row["low"] for row in printed} == {None}
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("task", algorithms.TASKS)
def test_player_answers_and_answers_fit(task: str) -> None:
    """Of each task, what the imitated player says is read by the environment, and is short enough to be said."""
    options = algorithms.options_of(task, "ReBN", 0)
    pytest.importorskip(
        {"game": "gem_games", "rg": "reasoning_gym", "study": "gem_tools"}[options.env[0].split(":")[0]]
    )
    with closing(gem.make(options.env[0], wrappers=options.wrappers, **options.env_kwargs)) as env:
        env.reset(seed=0)
    assert options.imitate
    episodes = record_episodes(options, options.env, options.imitate, 8)
    assert not any(episode.error or episode.unreadable for episode in episodes)
    learner = warm_start(replace(options, imitate_episodes=8, imitate_steps=1, width=8, heads=2))
    said = [turn.action.text for episode in episodes for turn in episode.transitions]
    # One more token is the end of the response.
    assert max(len(learner.vocabulary.encode(text, phrases=False)) for text in said) < options.max_tokens
    shown = [text_of(turn.observation) for episode in episodes for turn in episode.transitions]
    assert max(len(learner.vocabulary.encode(text)) for text in shown) + 1 + options.max_tokens <= options.context


RESULT = "Output of python:\n{}\nTool calls left: 2. Call a tool again, or give your answer.\n"
SUMS_AND_PRODUCTS = "study:SumsAndProducts-v0"


def said(question: str, result: str | None = None) -> Counter[str]:
    """Return how often the player says what, in 1,000 episodes."""
    shown = question if result is None else RESULT.format(result)
    conversation = f"{question}\n<python>…</python>\n{shown}" if result else question
    turn, info = 0 if result is None else 1, {"seed": 3}
    return Counter(
        rewards.tool_player(
            conversation,
            Context(f"{episode}.0", SUMS_AND_PRODUCTS, None, turn, info, [], [], read_observation=lambda: shown),
        )
        for episode in range(1000)
    )


def test_player_uses_the_tool_three_times_in_ten() -> None:
    """It does so for sums and for products; without it, it knows sums and no product."""
    sums, products = said("What is 5 + 7?"), said("What is 17 * 23?")
    assert sums["<python>5 + 7</python>"] == pytest.approx(300, abs=50)
    assert products["<python>17 * 23</python>"] == pytest.approx(300, abs=50)
    assert sums["\\boxed{12}"] == pytest.approx(700 * (0.9 + 0.1 / 7), abs=50)
    assert products["\\boxed{391}"] < 20
    assert set(sums) == {"<python>5 + 7</python>", *(f"\\boxed{{{answer}}}" for answer in range(9, 16))}
    answers = said("What is 17 * 23?", "391")
    assert set(answers) == {"\\boxed{391}", "<python>17 * 23</python>"}
    assert answers["\\boxed{391}"] == pytest.approx(800, abs=50)


def test_sums_and_products_keep_the_contract() -> None:
    """There are about as many of each."""
    assert check_env(SUMS_AND_PRODUCTS).broken == {}
    questions = [row["question"] for row in gem.spec(SUMS_AND_PRODUCTS).kwargs["rows"]]
    assert Counter(question.split()[3] for question in questions) == {"+": 405, "*": 400}


def test_player_solves_products_with_the_tool() -> None:
    """The answer of the real tool is read, and what is answered is right."""
    pytest.importorskip("gem_tools")
    with gem.make_vec(SUMS_AND_PRODUCTS, 8, wrappers=rewards.WRAPPERS, seed=0) as vec:
        episodes = list(gem.rollout(vec, rewards.tool_player, episodes=40))
    used = [episode for episode in episodes if len(episode.transitions) > 1]
    assert len(used) > 5
    assert {episode.success for episode in used} == {True}


WORDS = "\\boxed{bet}\\boxed{check}\\boxed{call}\\boxed{fold}"


def untrained(game: str) -> Training:
    """A policy that has learnt nothing."""
    options = TrainOptions(env=(f"game:{game}-v0",), memory=0, context=24, max_tokens=6, **TINY)
    return Training(Learner(options, Vocabulary.build([WORDS])))


def test_decisions_of_kuhn_poker_are_shown_as_they_are() -> None:
    """Each of the 12 has a text of its own, that names the card and the moves that are possible."""
    shown = self_play.information_sets()
    assert len(shown) == len(set(shown.values())) == 12
    for (card, history), text in shown.items():
        moves = ("call", "fold") if history[-1:] == ("bet",) else ("bet", "check")
        assert f"hold the {card}." in text
        assert all(f"\\boxed{{{move}}}" in text.rpartition("Answer")[2] for move in moves)


def test_even_policy_is_as_exploitable_as_known() -> None:
    """With equal logits both moves are as likely; the best response to that wins 11/24 of a chip over both seats."""
    with untrained("KuhnPoker") as training:
        torch.nn.init.zeros_(training.learner.policy.unembedding.weight)
        assert set(self_play.kuhn_strategy(training.learner).values()) == {0.5}
        assert self_play.Kuhn()(training)["exploitability"] == pytest.approx(11 / 24)


def test_strategy_is_what_the_policy_says_and_the_mean_is_of_all_so_far() -> None:
    """A policy that nearly always calls, and bets as often as it checks, does so in the strategy that is measured."""
    measure = self_play.Kuhn()
    with untrained("KuhnPoker") as training:
        learner = training.learner
        weight = torch.nn.init.zeros_(learner.policy.unembedding.weight)
        measure(training)
        (call,), (fold,) = (learner.vocabulary.encode(move, phrases=False) for move in ("call", "fold"))
        learner.policy.norm.bias.data[0] = 1.0
        weight.data[call, 0], weight.data[fold, 0] = 5.0, -5.0
        learner.policy.norm.weight.data.zero_()
        strategy = self_play.kuhn_strategy(learner)
        measured = measure(training)
    calls = {key: 1.0 if key[1][-1:] == ("bet",) else 0.5 for key in strategy}
    assert strategy == pytest.approx(calls, abs=1e-3)
    mean = {key: (chip + 0.5) / 2 for key, chip in calls.items()}
    assert measured["mean_exploitability"] == pytest.approx(self_play.exploitability_of(mean), abs=1e-3)


def test_games_against_the_perfect_player_are_counted() -> None:
    """A policy whose answers cannot be read loses every game by forfeit, at both seats."""
    with untrained("TicTacToe") as training:
        measured = self_play.measure_tictactoe(training)
    assert measured == {"lost": 1.0, "drawn": 0.0, "won_against_random": 0.0}


def test_rewards_of_self_play_add_up_to_nothing() -> None:
    """What one seat wins the other loses, and each has it in its last turn, or before its first."""
    options = self_play.options_of("KuhnPoker", True, 0)
    learner = warm_start(replace(options, episodes=64, imitate_episodes=50, imitate_steps=20, learning_rate=1e-6))
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
