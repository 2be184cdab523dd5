"""The study of the discount factor: ReBN with gamma 0.9 finds bisection, without being told to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gem_train.learner.options import Algorithm, TrainOptions
from gem_train.learner.training import Training
from gem_train.reporting import (
    Bar,
    bars_with_intervals,
    curves_with_bands,
    first_guesses,
    mean_interval,
    write_study_page,
)
from gem_train.studies.jobs import Job, run_jobs
from gem_train.studies.measured import curve, evaluated

GAMMAS = (0.5, 0.9, 0.999)
_NUMBERS, _MOST_TURNS, _SHOWN_TURNS = 50, 10, 3
_EVALUATED = 2048
_SETTINGS: tuple[tuple[Algorithm, float], ...] = tuple(
    (algorithm, gamma) for gamma in (0.9, 0.999, 0.5) for algorithm in ("rebn", "reinforce")
)
_QUICK: tuple[tuple[Algorithm, float], ...] = (("rebn", 0.9), ("reinforce", 0.9), ("rebn", 0.999))

TEXT = """\
The policy plays GuessTheNumber: a number from 1 to 50, at most 10 guesses, reward 1 for the right one whenever it is
made; a wrong one in the last turn earns less, the more the closer. Before it learns, it imitates a player that writes
down the interval that is left and names any number of it. That takes about 6.2 guesses; bisection takes 4.86 in the
mean, and no player takes fewer.

An undiscounted return says nothing of how soon the number was found. With a discount from turn to turn, an earlier hit
has the higher return; and Return Batch Normalization (ReBN) makes advantages of these differences: what is worse than
the mean of the batch is made less likely. REINFORCE on returns that are all above 0 pushes every guess up.

Mean turns count an episode that was not solved as 10. Intervals are of the mean over seeds, 95 %, Student's t; of one
seed, over its episodes.
"""


def options_of(algorithm: Algorithm, gamma: float, seed: int) -> TrainOptions:
    """Return the options of one run."""
    return TrainOptions(
        env=("game:GuessTheNumber-v0",),
        algorithm=algorithm,
        gamma=gamma,
        seed=seed,
        updates=230,
        episodes=256,
        learning_rate=1.6e-3,
        feedback=True,
        memory=1,
        max_tokens=10,
        context=64,
        imitate="gem_train.players:interval_player",
        imitate_steps=700,
        layers=1,
        heads=2,
        eval_episodes=_EVALUATED,
    )


def measure(training: Training) -> dict[str, Any]:
    """Return the mean turns of the evaluation, and how often each number was guessed in the first turns."""
    played = evaluated(training)
    turns = [len(seat.turns) if seat.success == 1.0 else _MOST_TURNS for seat in played]
    mean = sum(turns) / len(turns)
    guesses = [[0] * _NUMBERS for _ in range(_SHOWN_TURNS)]
    for seat in played:
        for number, turn in enumerate(seat.turns[:_SHOWN_TURNS]):
            guess = turn.text.rpartition("\\boxed{")[2].partition("}")[0]
            if guess.isdecimal() and 1 <= int(guess) <= _NUMBERS:
                guesses[number][int(guess) - 1] += 1
    return {
        "mean_turns": mean,
        "deviation": math.sqrt(sum((each - mean) ** 2 for each in turns) / (len(turns) - 1) / len(turns)),
        "success": sum(seat.success == 1.0 for seat in played) / len(played),
        "guesses": guesses,
    }


def optimal_turns(numbers: int) -> float:
    """Return the mean turns of bisection, the fewest that there can be.

    A guess tells whether the number is there, above or below: so at most ``2 ** (k - 1)`` numbers are found in turn k.
    """
    return sum(place.bit_length() for place in range(1, numbers + 1)) / numbers


def run(folder: Path, *, quick: bool, seeds: int, workers: int | None, quiet: bool) -> list[dict[str, Any]]:
    """Run the study, write its page and figures, and return its results.

    Args:
        folder: Where everything is kept; runs that are there are not made again.
        quick: Three settings.
        seeds: Number of seeds.
        workers: Processes; None for one a processor.
        quiet: Show no progress.
    """
    settings = _QUICK if quick else _SETTINGS
    jobs = {
        (algorithm, gamma): [
            Job(f"{algorithm}-{gamma}-{seed}", options_of(algorithm, gamma, seed), measure) for seed in range(seeds)
        ]
        for algorithm, gamma in settings
    }
    by_setting = run_jobs(jobs, folder, workers=workers, quiet=quiet)
    table = [_row(algorithm, gamma, runs) for (algorithm, gamma), runs in by_setting.items()]
    _write(folder, table, by_setting)
    return table


def _row(algorithm: str, gamma: float, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    last = [run["measured"][-1] for run in runs]
    interval = mean_interval([each["mean_turns"] for each in last])
    low, high = interval.low, interval.high
    if low is None:
        low, high = (interval.mean + side * 1.96 * last[0]["deviation"] for side in (-1, 1))
    return {
        "algorithm": algorithm,
        "gamma": gamma,
        "mean_turns": interval.mean,
        "low": low,
        "high": high,
        "success": sum(each["success"] for each in last) / len(last),
        "optimum": optimal_turns(_NUMBERS),
        "seconds": sum(run["seconds"] for run in runs),
    }


def _write(folder: Path, table: list[dict[str, Any]], by_setting: dict[tuple[Algorithm, float], list[Any]]) -> None:
    names = {
        setting: f"{'ReBN' if setting[0] == 'rebn' else 'REINFORCE'}, gamma {setting[1]}" for setting in by_setting
    }
    bars = [
        Bar(name, row["mean_turns"], row["low"], row["high"]) for name, row in zip(names.values(), table, strict=True)
    ]
    curves = {
        names[setting]: curve(
            range(1, len(runs[0]["curve"]) + 1), [[each["turns"] for each in run["curve"]] for run in runs]
        )
        for setting, runs in by_setting.items()
    }
    best = by_setting["rebn", 0.9]
    guesses = [
        [sum(run["measured"][-1]["guesses"][turn][place] for run in best) for place in range(_NUMBERS)]
        for turn in range(_SHOWN_TURNS)
    ]
    optimum = optimal_turns(_NUMBERS)
    write_study_page(
        folder / "index.html",
        "Discount and normalization",
        TEXT,
        figures=[
            (
                "Mean turns after learning.",
                bars_with_intervals(bars, folder / "turns.png", unit="mean turns", optimum=optimum),
            ),
            (
                "Turns of an episode while learning.",
                curves_with_bands({"GuessTheNumber": curves}, folder / "curves.png", unit="turns"),
            ),
            (
                "What ReBN with gamma 0.9 guesses first, second and third; the marks are bisection's own guesses.",
                first_guesses(guesses, folder / "guesses.png"),
            ),
        ],
        table=table,
    )
