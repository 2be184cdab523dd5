"""The study of transfer: train on one environment, evaluate on others while training."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gem_train.learner.options import TrainOptions
from gem_train.learner.training import Training
from gem_train.reporting import curves_with_bands, write_study_page
from gem_train.studies.jobs import Job, run_jobs
from gem_train.studies.measured import Run, evaluated, last_interval, measured_curve

TRAINED = {"one range": "game:GuessTheNumber-v0-hard", "any range": "game:GuessTheNumber-v0-random"}
EVALUATED = {
    "1 to 50": "game:GuessTheNumber-v0-hard",
    "1 to 10": "game:GuessTheNumber-v0-easy",
    "any range": "game:GuessTheNumber-v0-random",
    "Mastermind": "game:Mastermind-v0-easy",
}

TEXT = """\
The policy learns GuessTheNumber, and is evaluated on four tasks while it learns: numbers from 1 to 50 in 7 guesses,
from 1 to 10 in 4, a range that is drawn for each game, and Mastermind, a game of other rules that is answered in the
same form. Half of the runs learn 1 to 50 alone, the other half any range. Before that, each imitates a player that
writes down the interval that is left and names any number of it, on the environment that it will learn; so the values
at update 0 are those of imitation.

Intervals are of the mean over seeds, 95 %, Student's t.
"""


def options_of(trained: str, seed: int) -> TrainOptions:
    """Return the options of one run; ``trained`` is one of ``TRAINED``."""
    return TrainOptions(
        env=(TRAINED[trained],),
        eval_envs=tuple(EVALUATED.values()),
        algorithm="rebn",
        gamma=0.9,
        seed=seed,
        updates=80,
        episodes=256,
        learning_rate=1.5e-3,
        feedback=True,
        memory=1,
        max_tokens=10,
        context=128,
        imitate="gem_train.players:interval_player",
        imitate_steps=500,
        eval_episodes=512,
    )


def measure(training: Training) -> dict[str, Any]:
    """Return the success on each environment."""
    measured = {}
    for name, env_id in EVALUATED.items():
        played = evaluated(training, env_id)
        measured[name] = sum(seat.success == 1.0 for seat in played) / len(played)
    return measured


def run(folder: Path, *, quick: bool, seeds: int, workers: int | None, quiet: bool) -> list[dict[str, Any]]:
    """Run the study, write its page and figures, and return its results.

    Args:
        folder: Where everything is kept; runs that are there are not made again.
        quick: Changes nothing here.
        seeds: Number of seeds.
        workers: Processes; None for one a processor.
        quiet: Show no progress.
    """
    jobs = {
        trained: [
            Job(f"{trained.replace(' ', '-')}-{seed}", options_of(trained, seed), measure, every=20)
            for seed in range(seeds)
        ]
        for trained in TRAINED
    }
    by_setting = run_jobs(jobs, folder, workers=workers, quiet=quiet)
    table = [_row(trained, evaluated, runs) for trained, runs in by_setting.items() for evaluated in EVALUATED]
    curves = {
        evaluated: {
            f"trained on {trained.replace('one range', '1 to 50')}": measured_curve(runs, partial(_success, evaluated))
            for trained, runs in by_setting.items()
        }
        for evaluated in EVALUATED
    }
    drawn = curves_with_bands(curves, folder / "curves.png", unit="success", percent=True)
    figures = [("Success on what is evaluated, while the policy learns.", drawn)]
    write_study_page(folder / "index.html", "Transfer", TEXT, figures=figures, table=table)
    return table


def _success(evaluated: str, measured: dict[str, float]) -> float:
    return measured[evaluated]


def _row(trained: str, evaluated: str, runs: Sequence[Run]) -> dict[str, Any]:
    interval = last_interval(runs, partial(_success, evaluated))
    return {
        "trained": TRAINED[trained],
        "evaluated": EVALUATED[evaluated],
        "imitation": sum(run["measured"][0][evaluated] for run in runs) / len(runs),
        "success": interval.mean,
        "low": interval.low,
        "high": interval.high,
        "seconds": sum(run["seconds"] for run in runs),
    }
