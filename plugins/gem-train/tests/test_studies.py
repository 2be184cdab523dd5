"""Runs in processes of their own, kept results, and the study of the discount factor."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("torch")

from study_measures import double

from gem_train import TrainOptions, gamma_study
from gem_train.studies import run_all, train_measured


def test_runs_are_kept_and_not_made_again(tmp_path: Path) -> None:
    """What a killed study has half written is made again, a kept result is taken; a failed run keeps the others."""
    (tmp_path / "results.jsonl").write_text('{"setting": {"number": 2}, "result": {"double": 5}}\n{"setting": {"num')
    settings = [{"number": 2}, {"number": 1}, {"number": 3}]
    with pytest.raises(ValueError, match="three"):
        run_all(double, settings, tmp_path, workers=1)
    kept = [{"number": 2, "double": 5}, {"number": 1, "double": 2}]
    assert run_all(double, settings[:2], tmp_path) == kept
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize(("numbers", "turns"), [(1, 1), (2, 3 / 2), (7, 17 / 7), (8, 21 / 8), (50, 4.86)])
def test_optimum_is_that_of_the_best_search_tree(numbers: int, turns: float) -> None:
    """Depths of balanced trees: one node at depth 1, two at 2, four at 3."""
    assert gamma_study.optimal_turns(numbers) == pytest.approx(turns)


def test_policy_is_measured_before_while_and_after_it_learns() -> None:
    """One that has learnt nothing says nothing that can be read: it counts as all turns, not as quick."""
    small = {"updates": 3, "episodes": 4, "eval_episodes": 4, "width": 8, "heads": 2, "max_tokens": 4, "memory": 1}
    options = TrainOptions(env=("game:GuessTheNumber-v0",), context=160, imitate=None, **small)
    result = train_measured(options, gamma_study.measure, every=2)
    assert [measured["update"] for measured in result["measured"]] == [0, 2, 3]
    assert len(result["curve"]) == 3
    assert [(measured["mean_turns"], measured["success"]) for measured in result["measured"]] == [(10, 0)] * 3
    assert [len(row) for row in result["measured"][0]["guesses"]] == [50, 50, 50]


def test_command_reports_kept_results(tmp_path: Path) -> None:
    """A row for each of the three settings of the quick study."""
    with (tmp_path / "results.jsonl").open("w") as file:
        for place, (algorithm, gamma) in enumerate(gamma_study.QUICK_SETTINGS):
            measured = {"mean_turns": 4.9 + place, "success": 1.0, "guesses": [[1] * 50] * 3}
            result = {"curve": [{"turns": 6.0}, {"turns": 5.0}], "measured": [measured], "seconds": 60.0}
            setting = {"algorithm": algorithm, "gamma": gamma, "seed": 0}
            file.write(json.dumps({"setting": setting, "result": result}) + "\n")
    called = CliRunner().invoke(gamma_study.command, ["gamma", "--quick", "--out", str(tmp_path)])
    assert [line.split()[:3] for line in called.output.splitlines() if "0.9" in line] == [
        ["ReBN", "0.9", "4.9"],
        ["REINFORCE", "0.9", "5.9"],
        ["ReBN", "0.999", "6.9"],
    ]
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
