"""The study of rewards: is a tool learnt where it is needed, and is it used where it is not?"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gem_core as gem
from gem_train.learner.options import Algorithm, TrainOptions
from gem_train.learner.training import Training
from gem_train.reporting import curves_with_bands, write_study_page
from gem_train.studies.jobs import Job, run_jobs
from gem_train.studies.measured import Run, evaluated, last_interval, measured_curve

ENV_ID = "study:SumsAndProducts-v0"
WRAPPERS = ("python", ("tools", {"max_tool_uses": 3, "instructions": False}))
"""The policy learns of the tool from the player that it imitates; instructions would only be more to read."""

KINDS = {"sums": " + ", "products": " * "}

# About as many of each; there are 81 different sums and 400 products.
_SUMS = [(f"{left} + {right}", left + right) for left in range(1, 10) for right in range(1, 10)] * 5
_PRODUCTS = [(f"{left} * {right}", left * right) for left in range(11, 31) for right in range(11, 31)]

gem.register(
    ENV_ID,
    gem.DatasetEnv,
    rows=[{"question": f"What is {text}?", "answer": str(value)} for text, value in (*_SUMS, *_PRODUCTS)],
    summary="A sum of two digits, or a product of two numbers from 11 to 30.",
)


class Setting(NamedTuple):
    """What is compared: an algorithm, and the reward of a wrong answer; that of a right one is 1."""

    algorithm: Algorithm
    failure_reward: float

    @property
    def label(self) -> str:
        """Its name in figures."""
        name = "ReBN" if self.algorithm == "rebn" else "REINFORCE"
        return f"{name}, {self.failure_reward:g} and 1"


SETTINGS = (Setting("reinforce", 0.0), Setting("reinforce", -1.0), Setting("rebn", 0.0))

TEXT = """\
Half of the questions are sums of two digits, half are products of two numbers from 11 to 30. An answer ends the
episode; before it, the Python tool of gem-tools may be called up to three times. The policy first imitates a player
that calls the tool three times in ten, whatever is asked, and again one time in five; without it, that player is right
about nine sums in ten and no product. So the tool is needed for products alone.

Compared are REINFORCE with rewards of 0 and 1, REINFORCE with -1 and 1, and Return Batch Normalization (ReBN) of 0 and
1. A call is a turn, and the discount from turn to turn is 0.8: a right answer after a call returns 0.8 to it.

Intervals are of the mean over seeds, 95 %, Student's t.
"""


def options_of(setting: Setting, seed: int) -> TrainOptions:
    """Return the options of one run."""
    return TrainOptions(
        env=(ENV_ID,),
        wrappers=WRAPPERS,
        algorithm=setting.algorithm,
        failure_reward=setting.failure_reward,
        gamma=0.8,
        seed=seed,
        updates=50,
        episodes=192,
        learning_rate=7e-4,
        max_tokens=16,
        context=128,
        imitate="gem_train.players:tool_player",
        imitate_episodes=2500,
        imitate_steps=500,
        eval_episodes=256,
    )


def measure(training: Training) -> dict[str, Any]:
    """Return success, the share of episodes with the tool, and the mean calls, of sums and of products."""
    played = evaluated(training)
    measured: dict[str, Any] = {}
    for kind, sign in KINDS.items():
        seats = [seat for seat in played if sign in str(seat.turns[0].shown)]
        calls = [len(seat.turns) - 1 for seat in seats]
        measured[kind] = {
            "success": sum(seat.success == 1.0 for seat in seats) / len(seats),
            "with_tool": sum(call > 0 for call in calls) / len(calls),
            "calls": sum(calls) / len(calls),
        }
    return measured


def run(folder: Path, *, quick: bool, seeds: int, workers: int | None, quiet: bool) -> list[dict[str, Any]]:
    """Run the study, write its page and figures, and return its results.

    Args:
        folder: Where everything is kept; runs that are there are not made again.
        quick: Changes nothing here.
        seeds: Number of seeds.
        workers: Processes; None for one a processor.
        quiet: Show no progress.

    Raises:
        GemError: The tool, of the distribution gem-tools, is not there; the message says what to install.
    """
    gem.make(ENV_ID, wrappers=WRAPPERS).close()
    jobs = {
        setting: [
            Job(f"{setting.algorithm}{setting.failure_reward:+g}-{seed}", options_of(setting, seed), measure, every=10)
            for seed in range(seeds)
        ]
        for setting in SETTINGS
    }
    by_setting = run_jobs(jobs, folder, workers=workers, quiet=quiet)
    table = [_row(setting, kind, runs) for setting, runs in by_setting.items() for kind in KINDS]
    captions = {
        "success": "Success while learning.",
        "with_tool": "Share of episodes with at least one call of the tool.",
        "calls": "Mean calls of an episode.",
    }
    figures = [
        (
            caption,
            curves_with_bands(
                {
                    kind.capitalize(): {
                        setting.label: measured_curve(runs, partial(_value, kind, name))
                        for setting, runs in by_setting.items()
                    }
                    for kind in KINDS
                },
                folder / f"{name}.png",
                unit=name.replace("_", " "),
                percent=name != "calls",
            ),
        )
        for name, caption in captions.items()
    ]
    write_study_page(folder / "index.html", "Rewards and a tool", TEXT, figures=figures, table=table)
    return table


def _value(kind: str, name: str, measured: dict[str, Any]) -> float:
    value: float = measured[kind][name]
    return value


def _row(setting: Setting, kind: str, runs: Sequence[Run]) -> dict[str, Any]:
    success, with_tool, calls = (
        last_interval(runs, partial(_value, kind, name)) for name in ("success", "with_tool", "calls")
    )
    return {
        "setting": setting.label,
        "questions": kind,
        "success": success.mean,
        "low": success.low,
        "high": success.high,
        "with_tool": with_tool.mean,
        "tool_low": with_tool.low,
        "tool_high": with_tool.high,
        "calls": calls.mean,
        "seconds": sum(run["seconds"] for run in runs),
    }
