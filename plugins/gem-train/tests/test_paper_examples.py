"""The studies in examples/paper: their tasks, what they measure, and a tiny run of each."""

from __future__ import annotations

import importlib
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import gem_core as gem

pytest.importorskip("gem_games")
pytest.importorskip("gem_tools")
pytest.importorskip("reasoning_gym")
torch = pytest.importorskip("torch")

from gem_train.learner.imitation import record_episodes  # noqa: E402 - after the checks for what is optional
from gem_train.learner.learning import Learner  # noqa: E402
from gem_train.learner.options import TrainOptions  # noqa: E402
from gem_train.learner.playing import text_of  # noqa: E402
from gem_train.learner.training import Training, warm_start  # noqa: E402
from gem_train.learner.vocabulary import Vocabulary  # noqa: E402

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


@pytest.mark.parametrize(("name", "rows"), [("rewards", 6), ("transfer", 8), ("algorithms", 6), ("self_play", 10)])
def test_study_runs_from_imitation_to_its_figure(
    name: str, rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the smallest size, in this process; one seed has no interval."""
    study, printed = script(name), []
    options_of = study.options_of
    monkeypatch.setattr(study, "options_of", lambda *given: replace(options_of(*given), **TINY))
    monkeypatch.setattr(study, "RANDOM_EPISODES", 8, raising=False)
    monkeypatch.setattr(
        study, "run_all", lambda run, settings, *_, **__: [{**each, **run(**each)} for each in settings]
    )
    monkeypatch.setattr(study, "print_rows", printed.extend)
    study.main(["--quick", "--out", str(tmp_path)], standalone_mode=False)
    assert len(printed) == rows
    assert {row["low"] for row in printed} == {None}
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("task", algorithms.TASKS)
def test_player_answers_and_answers_fit(task: str) -> None:
    """Of each task, what the imitated player says is read by the environment, and is short enough to be said."""
    options = algorithms.options_of(task, "ReBN", 0)
    episodes = record_episodes(options, options.env, str(options.imitate), 8)
    assert not any(episode.error or episode.unreadable for episode in episodes)
    learner = warm_start(replace(options, imitate_episodes=8, imitate_steps=1, width=8, heads=2))
    turns = [turn for episode in episodes for turn in episode.transitions]
    # One more token is the end of the response.
    said = max(len(learner.vocabulary.encode(turn.action.text, phrases=False)) for turn in turns)
    shown = max(len(learner.vocabulary.encode(text_of(turn.observation))) for turn in turns)
    assert said < options.max_tokens
    assert shown + 1 + options.max_tokens <= options.context


def test_player_uses_the_tool_three_times_in_ten() -> None:
    """For sums and for products, whose result it reads; without it, it knows most sums and no product."""
    plan = [gem.PlanItem(options={"index": row}) for row in (*range(150), *range(405, 555))]
    with gem.make_vec("study:SumsAndProducts-v0", 8, wrappers=rewards.WRAPPERS, seed=0) as vec:
        episodes = list(gem.rollout(vec, rewards.tool_player, plan=plan))
    seen = Counter(
        ("+" if " + " in str(episode.observation) else "*", episode.turns > 1, episode.success) for episode in episodes
    )
    assert 60 < sum(count for (_, tool, _), count in seen.items() if tool) < 120
    assert seen["*", True, True] > 10 * seen["*", True, False]  # one that asks again and again never answers
    assert seen["+", False, True] > 5 * seen["+", False, False]
    assert seen["*", False, True] < 5 < seen["*", False, False]


def untrained(game: str) -> Training:
    """A policy that has learnt nothing."""
    options = TrainOptions(env=(f"game:{game}-v0",), memory=0, context=24, max_tokens=6, **TINY)
    return Training(Learner(options, Vocabulary.build(["\\boxed{bet}\\boxed{check}\\boxed{call}\\boxed{fold}"])))


def test_strategy_is_what_the_policy_says_and_the_mean_is_of_all_so_far() -> None:
    """Even chances are exploited for 11/24 chips; then a policy that always calls, and bets as often as it checks."""
    shown = self_play.information_sets()
    assert len(shown) == len(set(shown.values())) == 12
    measure = self_play.Kuhn()
    with untrained("KuhnPoker") as training:
        learner = training.learner
        weight = torch.nn.init.zeros_(learner.policy.unembedding.weight)
        assert set(self_play.kuhn_strategy(learner).values()) == {0.5}
        assert measure(training)["exploitability"] == pytest.approx(11 / 24)
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
