"""Studies: runs in processes of their own, kept results, and the study of the discount factor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import pytest

pytest.importorskip("torch")

from study_measures import count_turns

from gem_train.learner.options import TrainOptions
from gem_train.learner.training import Training, warm_start
from gem_train.studies import gamma
from gem_train.studies.jobs import Job, run_jobs

TINY = {
    "env": ("game:GuessTheNumber-v0",),
    "updates": 1,
    "episodes": 4,
    "eval_episodes": 4,
    "width": 8,
    "heads": 2,
    "context": 64,
    "max_tokens": 4,
    "feedback": True,
    "memory": 1,
    "imitate": None,
}


def test_runs_are_kept_and_not_made_again(tmp_path: Path) -> None:
    """A result of other options is made again, a kept one is not; runs that differ in the algorithm share a start."""
    (tmp_path / "rebn.json").write_text(json.dumps({"options": {}, "measured": []}))
    jobs = {
        name: [Job(name, TrainOptions(**TINY, algorithm=name), count_turns, every=1)]  # type: ignore[arg-type]
        for name in ("rebn", "reinforce")
    }
    first = run_jobs(jobs, tmp_path, workers=1, quiet=True)
    assert [measured["update"] for measured in first["rebn"][0]["measured"]] == [0, 1]
    assert len(first["rebn"][0]["curve"]) == 1
    assert len(list(tmp_path.glob("start-*.pt"))) == 1
    written = (tmp_path / "rebn.json").stat().st_mtime_ns
    assert run_jobs(jobs, tmp_path, workers=1, quiet=True) == first
    assert (tmp_path / "rebn.json").stat().st_mtime_ns == written


FOREVER = """
from pathlib import Path
from study_measures import wait_forever
from gem_train.learner.options import TrainOptions
from gem_train.studies.jobs import Job, run_jobs

if __name__ == "__main__":
    options = TrainOptions(env=("game:GuessTheNumber-v0",), imitate=None, updates=1, width=8, heads=2)
    run_jobs({None: [Job("one", options, wait_forever, every=1)]}, Path("study"), workers=1, quiet=True)
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
    assert gamma.optimal_turns(numbers) == pytest.approx(fewest_turns(numbers) / numbers)


def test_unsolved_episodes_count_as_all_turns() -> None:
    """A policy that has learnt nothing says nothing that can be read, and is not said to be quick."""
    with Training(warm_start(TrainOptions(**TINY))) as training:
        measured = gamma.measure(training)
    assert (measured["mean_turns"], measured["success"]) == (10, 0)
    assert [len(row) for row in measured["guesses"]] == [50, 50, 50]


def test_study_of_gamma_writes_its_table_page_and_figures(tmp_path: Path) -> None:
    """From results that are there; the interval of one seed is over its episodes."""
    for place, (algorithm, factor) in enumerate((("rebn", 0.9), ("reinforce", 0.9), ("rebn", 0.999))):
        result = {
            "options": gamma.options_of(algorithm, factor, 0).to_dict(),  # type: ignore[arg-type]
            "seconds": 60.0,
            "curve": [{"turns": 6.0}, {"turns": 5.0 + place}],
            "measured": [
                {
                    "update": 130,
                    "mean_turns": 4.9 + place,
                    "deviation": 0.1,
                    "success": 1.0,
                    "guesses": [[1] * 50] * 3,
                }
            ],
        }
        (tmp_path / f"{algorithm}-{factor}-0.json").write_text(json.dumps(result))
    rows = gamma.run(tmp_path, quick=True, seeds=1, workers=1, quiet=True)
    assert rows[0] == {
        "algorithm": "rebn",
        "gamma": 0.9,
        "mean_turns": 4.9,
        "low": pytest.approx(4.704),
        "high": pytest.approx(5.096),
        "success": 1.0,
        "optimum": pytest.approx(4.86),
        "seconds": 60.0,
    }
    assert [row["mean_turns"] for row in rows] == [4.9, 5.9, 6.9]
    assert {path.name for path in tmp_path.glob("*.png")} == {"turns.png", "curves.png", "guesses.png"}
    assert "Return Batch Normalization" in (tmp_path / "index.html").read_text()
