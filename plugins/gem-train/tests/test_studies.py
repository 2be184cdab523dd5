"""Studies: runs in processes of their own, kept results, and the study of the discount factor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("torch")

from study_measures import double

from gem_train import TrainOptions, gamma_study
from gem_train.studies import run_all, train_measured


def test_runs_are_kept_and_not_made_again(tmp_path: Path) -> None:
    """What a killed study has half written is made again; a kept result is taken as it is."""
    (tmp_path / "results.jsonl").write_text('{"setting": {"number": 2}, "result": {"double": 5}}\n{"setting": {"num')
    settings = [{"number": 1}, {"number": 2}]
    expected = [{"number": 1, "double": 2}, {"number": 2, "double": 5}]
    assert run_all(double, settings, tmp_path, workers=1) == expected
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 2
    assert run_all(double, settings[::-1], tmp_path) == expected[::-1]


def test_failed_run_keeps_what_ended_before(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="three"):
        run_all(double, [{"number": 1}, {"number": 3}], tmp_path, workers=1)
    assert json.loads((tmp_path / "results.jsonl").read_text())["result"] == {"double": 2}


FOREVER = """
from pathlib import Path
from study_measures import wait_forever
from gem_train.studies import run_all

if __name__ == "__main__":
    run_all(wait_forever, [{}], Path("study"), workers=1)
"""


@pytest.mark.thorough
def test_a_killed_study_leaves_no_process(tmp_path: Path) -> None:
    """Its output ends when the last process that could write to it has ended."""
    (tmp_path / "study.py").write_text(FOREVER)
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    study = subprocess.Popen([sys.executable, "study.py"], cwd=tmp_path, env=env, stdout=subprocess.PIPE, text=True)
    assert study.stdout is not None
    assert study.stdout.readline() == "measuring\n"
    study.kill()
    assert study.stdout.read() == ""
    study.wait()
    study.stdout.close()


@lru_cache
def fewest_turns(numbers: int) -> float:
    """Sum of the turns in which each of so many numbers is found, by the best first guess."""
    if numbers == 0:
        return 0
    return numbers + min(fewest_turns(below) + fewest_turns(numbers - 1 - below) for below in range(numbers))


@pytest.mark.parametrize("numbers", [1, 2, 7, 8, 50])
def test_optimum_is_that_of_the_best_search_tree(numbers: int) -> None:
    assert gamma_study.optimal_turns(numbers) == pytest.approx(fewest_turns(numbers) / numbers)


def test_bisection_halves_what_is_left() -> None:
    assert [gamma_study.bisection_guesses(7, turn) for turn in (1, 2, 3)] == [[4], [2, 6], [1, 3, 5, 7]]


def test_policy_is_measured_before_while_and_after_it_learns() -> None:
    """One that has learnt nothing says nothing that can be read: it counts as all turns, not as quick."""
    options = TrainOptions(
        env=("game:GuessTheNumber-v0",),
        updates=3,
        episodes=4,
        eval_episodes=4,
        width=8,
        heads=2,
        context=64,
        max_tokens=4,
        feedback=True,
        memory=1,
        imitate=None,
    )
    result = train_measured(options, gamma_study.measure, every=2)
    assert [measured["update"] for measured in result["measured"]] == [0, 2, 3]
    assert len(result["curve"]) == 3
    assert [(measured["mean_turns"], measured["success"]) for measured in result["measured"]] == [(10, 0)] * 3
    assert [len(row) for row in result["measured"][0]["guesses"]] == [50, 50, 50]


def test_command_reports_kept_results(tmp_path: Path) -> None:
    """The quick study has three settings; the interval of one seed is over its episodes."""
    with (tmp_path / "results.jsonl").open("w") as file:
        for place, (algorithm, gamma) in enumerate(gamma_study.QUICK_SETTINGS):
            measured = {"mean_turns": 4.9 + place, "error": 0.1, "success": 1.0, "guesses": [[1] * 50] * 3}
            result = {"curve": [{"turns": 6.0}, {"turns": 5.0}], "measured": [measured], "seconds": 60.0}
            setting = {"algorithm": algorithm, "gamma": gamma, "seed": 0}
            file.write(json.dumps({"setting": setting, "result": result}) + "\n")
    called = CliRunner().invoke(gamma_study.command, ["gamma", "--quick", "--json", "--out", str(tmp_path)])
    rows = json.loads(called.stdout)
    assert rows[0] == {
        "algorithm": "ReBN",
        "gamma": 0.9,
        "mean_turns": 4.9,
        "low": pytest.approx(4.704),
        "high": pytest.approx(5.096),
        "success": 1.0,
        "optimum": pytest.approx(4.86),
        "seconds": 60.0,
    }
    assert [(row["algorithm"], row["mean_turns"]) for row in rows[1:]] == [("REINFORCE", 5.9), ("ReBN", 6.9)]
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
