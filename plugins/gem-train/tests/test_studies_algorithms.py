"""The study of algorithms: its table of tasks, and a tiny run."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

pytest.importorskip("torch")

from gem_train.learner.imitation import record_episodes
from gem_train.learner.playing import text_of
from gem_train.learner.training import warm_start
from gem_train.studies import algorithms

_NEEDS = {"game": "gem_games", "rg": "reasoning_gym", "study": "gem_tools"}


@pytest.mark.parametrize("task", algorithms.TASKS, ids=lambda task: task.name)
def test_player_answers_and_answers_fit(task: algorithms.Task) -> None:
    """Of each task, what the imitated player says is read by the environment, and is short enough to be said."""
    pytest.importorskip(_NEEDS[task.env.partition(":")[0]])
    options = algorithms.options_of(task, "rebn", 0)
    with closing(gem.make(task.env, wrappers=options.wrappers, **task.env_kwargs)) as env:
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


def test_study_runs_from_imitation_to_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One task, every algorithm, two updates; the algorithms share a warm start."""
    pytest.importorskip("gem_games")
    options_of = algorithms.options_of
    tiny: dict[str, Any] = {"updates": 2, "episodes": 8, "eval_episodes": 4, "width": 8, "heads": 2}
    tiny |= {"imitate_episodes": 8, "imitate_steps": 2}
    monkeypatch.setattr(algorithms, "options_of", lambda *given: replace(options_of(*given), **tiny))
    tasks = [task for task in algorithms.TASKS if task.name == "TowerofHanoi"]
    monkeypatch.setattr(algorithms, "TASKS", tasks)
    rows = algorithms.run(tmp_path, quick=False, seeds=1, workers=1, quiet=True)
    assert [(row["task"], row["algorithm"]) for row in rows] == [
        (task.name, label) for task in tasks for label in algorithms.LABELS.values()
    ]
    assert len(list(tmp_path.glob("start-*.pt"))) == len(tasks)
    assert (tmp_path / "curves.png").exists()
    assert "ReBN" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_quick_study_is_three_tasks_and_two_algorithms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From results that are there; the number of seeds is one."""
    measured = [{"update": update, "success": 0.1 * update, "return": 0.0} for update in (0, 5)]
    result = {"seconds": 1.0, "measured": measured}
    monkeypatch.setattr(algorithms, "run_jobs", lambda jobs, folder, **given: {setting: [result] for setting in jobs})
    monkeypatch.setattr(algorithms, "random_player", lambda task: {"success": 0.25, "return": 0.5})
    rows = algorithms.run(tmp_path, quick=True, seeds=1, workers=1, quiet=True)
    assert len({row["task"] for row in rows}) == 3
    assert len({row["algorithm"] for row in rows}) == 2
    assert rows[0]["seconds"] == 1.0
    assert [rows[0][name] for name in ("success", "imitation_success", "random_success")] == [0.5, 0.0, 0.25]
