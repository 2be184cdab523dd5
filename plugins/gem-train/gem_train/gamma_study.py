"""``gem train-study gamma``: ReBN with gamma 0.9 finds bisection, without being told to.

The policy plays GuessTheNumber: a number from 1 to 50, at most 10 guesses, reward 1 for the right one whenever it is
made; a wrong one in the last turn earns less, the more the closer. Before it learns, it imitates a player that writes
down the interval that is left and names any number of it. That takes about 6.2 guesses; bisection takes 4.86 in the
mean, and no player takes fewer.

An undiscounted return says nothing of how soon the number was found. With a discount from turn to turn, an earlier hit
has the higher return; and Return Batch Normalization (ReBN) makes advantages of these differences: what is worse than
the mean of the batch is made less likely. REINFORCE on returns that are all above 0 pushes every guess up.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from gem_core.cli import echo_line
from gem_core.env import stable_hash
from gem_core.errors import MissingRequirementError
from gem_train.learner.options import Algorithm, TrainOptions
from gem_train.reporting import mean_interval
from gem_train.studies import evaluated, plot_seeds, print_rows, run_all, study_options, train_measured

if TYPE_CHECKING:
    from gem_core.rollouts import Context
    from gem_core.types import Observation
    from gem_train.learner.training import Training

LABELS: dict[Algorithm, str] = {"rebn": "ReBN", "reinforce": "REINFORCE"}
SETTINGS: tuple[tuple[Algorithm, float], ...] = tuple(
    (algorithm, gamma) for gamma in (0.9, 0.999, 0.5) for algorithm in LABELS
)
QUICK_SETTINGS = SETTINGS[:3]
NUMBERS, MOST_TURNS, SHOWN_TURNS = 50, 10, 3

_RANGE = re.compile(r"The number is from (-?\d+) to (-?\d+)\.", re.ASCII)
_HINT = re.compile(r"(higher|lower) than (-?\d+)", re.ASCII)
_SLIPS = 0.04


def interval_player(observation: Observation, context: Context) -> str:
    r"""Play GuessTheNumber: write down the interval that is left, then any number of it, as ``13 to 24 \boxed{18}``.

    It seldom slips and names any number of the range, so that who imitates it has seen what comes of that.
    """
    shown = str(context.observation)
    low, high = first = tuple(map(int, _RANGE.findall(shown)[-1]))
    for side, number in _HINT.findall(shown.rpartition("Hints so far")[2]):
        low, high = (max(low, int(number) + 1), high) if side == "higher" else (low, min(high, int(number) - 1))
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    lowest, highest = first if random.random() < _SLIPS else (low, high)
    return f"{low} to {high} \\boxed{{{random.integers(lowest, highest + 1)}}}"


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
        imitate=f"{__name__}:interval_player",
        imitate_steps=700,
        layers=1,
        heads=2,
        eval_episodes=2048,
    )


def run(algorithm: Algorithm, gamma: float, seed: int) -> dict[str, Any]:
    """Train one policy, and measure it at the end."""
    return train_measured(options_of(algorithm, gamma, seed), measure)


def measure(training: Training) -> dict[str, Any]:
    """Return the mean turns of the evaluation, and how often each number was guessed in the first turns.

    An episode that was not solved counts as all turns.
    """
    played = evaluated(training)
    turns = [len(seat.turns) if seat.success == 1.0 else MOST_TURNS for seat in played]
    guesses = [[0] * NUMBERS for _ in range(SHOWN_TURNS)]
    for seat in played:
        for counts, turn in zip(guesses, seat.turns, strict=False):
            guess = turn.text.rpartition("\\boxed{")[2].partition("}")[0]
            if guess.isdecimal() and 1 <= int(guess) <= NUMBERS:
                counts[int(guess) - 1] += 1
    return {
        "mean_turns": fmean(turns),
        "success": fmean(seat.success == 1.0 for seat in played),
        "guesses": guesses,
    }


def optimal_turns(numbers: int) -> float:
    """Return the mean turns of bisection, the fewest that there can be.

    A guess tells whether the number is there, above or below: so at most ``2 ** (k - 1)`` numbers are found in turn k.
    """
    return sum(place.bit_length() for place in range(1, numbers + 1)) / numbers


def table(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each setting: the mean over seeds with its interval."""
    rows = []
    for algorithm, gamma in dict.fromkeys((result["algorithm"], result["gamma"]) for result in results):
        runs = [result for result in results if (result["algorithm"], result["gamma"]) == (algorithm, gamma)]
        last = [each["measured"][-1] for each in runs]
        mean, low, high = mean_interval([each["mean_turns"] for each in last])
        rows.append(
            {
                "algorithm": LABELS[algorithm],
                "gamma": gamma,
                "mean_turns": mean,
                "low": low,
                "high": high,
                "success": fmean(each["success"] for each in last),
                "optimum": optimal_turns(NUMBERS),
                "seconds": sum(each["seconds"] for each in runs),
            }
        )
    return rows


def draw(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the turns of an episode while learning, and what ReBN with gamma 0.9 guesses first, second and third."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    panels = figure.subplot_mosaic([["turns"] * SHOWN_TURNS, [*range(SHOWN_TURNS)]])
    for algorithm, gamma in dict.fromkeys((result["algorithm"], result["gamma"]) for result in results):
        runs = [result for result in results if (result["algorithm"], result["gamma"]) == (algorithm, gamma)]
        turns = [[each["turns"] for each in result["curve"]] for result in runs]
        plot_seeds(panels["turns"], range(1, len(turns[0]) + 1), turns, f"{LABELS[algorithm]}, gamma {gamma}")
    panels["turns"].axhline(optimal_turns(NUMBERS), color="black", linestyle="--", label="bisection")
    panels["turns"].set(xlabel="update", ylabel="turns of an episode")
    panels["turns"].legend(ncols=2)
    best = [result["measured"][-1] for result in results if (result["algorithm"], result["gamma"]) == ("rebn", 0.9)]
    for turn in range(SHOWN_TURNS):
        counts = [sum(of_number) for of_number in zip(*(each["guesses"][turn] for each in best), strict=True)]
        panels[turn].bar(range(1, NUMBERS + 1), counts)
        panels[turn].set(title=f"Guess {turn + 1}", xlabel="number guessed")
    figure.savefig(path, dpi=160)


@click.command(
    "train-study",
    epilog="""\b
Examples:
  gem train-study gamma --quick
  gem train-study gamma --out runs/gamma
\b
The same command goes on with a study that was stopped. Its folder has results.jsonl, a line a run, and
figure.png. The other studies are scripts in examples/paper of the repository.
""",
)
@click.argument("study", type=click.Choice(["gamma"]), metavar="gamma")
@study_options("gamma")
def command(study: str, quick: bool, seeds: int, workers: int | None, folder: Path) -> None:
    """Train many small policies and compare them, with intervals over seeds.

    The study gamma: gamma of 0.5, 0.9 and 0.999, with REINFORCE and with ReBN, on GuessTheNumber.
    """
    if find_spec("torch") is None:
        raise MissingRequirementError("gem train-study needs PyTorch: pip install 'gem-train[torch]'")
    settings = [
        {"algorithm": algorithm, "gamma": gamma, "seed": seed}
        for seed in range(seeds)
        for algorithm, gamma in (QUICK_SETTINGS if quick else SETTINGS)
    ]
    results = run_all(run, settings, folder, workers=workers)
    draw(results, folder / "figure.png")
    print_rows(table(results))
    echo_line(f"figure: {folder / 'figure.png'}")
