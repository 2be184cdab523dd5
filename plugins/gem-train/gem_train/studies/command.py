"""``gem train-study``: show a claim of the paper by many small runs."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli import AtLeast, Column, echo_line, print_table
from gem_core.errors import MissingRequirementError

if TYPE_CHECKING:
    from collections.abc import Callable

STUDIES = {
    "gamma": "gamma of 0.5, 0.9, 0.999 with REINFORCE and with ReBN on GuessTheNumber",
    "algorithms": "REINFORCE, ReBN, PPO and GRPO on five games, additions, and questions with the Python tool",
    "rewards": "rewards of 0 and 1, of -1 and 1, and ReBN, on sums and products with the Python tool",
    "transfer": "train on GuessTheNumber, evaluate on other ranges and on Mastermind while training",
    "self-play": "one policy at both seats of KuhnPoker and TicTacToe, with and without per-role baselines",
}
"""What each shows; a study is the function ``run`` of the module of its name."""

_LISTED = "\n".join(f"  {name:12}{text}" for name, text in STUDIES.items())


@click.command(
    "train-study",
    epilog=f"""\b
Studies:
{_LISTED}
\b
Examples:
  gem train-study gamma --quick
  gem train-study gamma --out runs/gamma --json
\b
The same command goes on with a study that was stopped, and keeps its finished runs.
Its folder holds a page (index.html), figures and the result of each run.
""",
)
@click.argument("study", type=click.Choice(list(STUDIES)), metavar="STUDY")
@click.option("-q", "--quick", is_flag=True, help="One seed, and fewer settings: minutes instead of half an hour.")
@click.option("--seeds", type=AtLeast(min=1), help="Runs of each setting.  [default: 5; 1 for algorithms and --quick]")
@click.option("-w", "--workers", type=AtLeast(min=1), help="Runs at once, each on one thread.  [default: processors]")
@click.option("-o", "--out", type=click.Path(file_okay=False), help="Folder of the study.  [default: runs/study-STUDY]")
@click.option("--json", "as_json", is_flag=True, help="Write the results as JSON.")
def command(study: str, quick: bool, seeds: int | None, workers: int | None, out: str | None, as_json: bool) -> None:
    """Train many small policies and compare them, with intervals over seeds.

    Everything runs on the processors of this machine, from imitation of a scripted player to the page of results.
    """
    folder = Path(out or f"runs/study-{study}{'-quick' if quick else ''}")
    seeds = seeds or (1 if quick or study == "algorithms" else 5)
    results = _study(study)(folder, quick=quick, seeds=seeds, workers=workers, quiet=False)
    if as_json:
        sys.stdout.write(json.dumps(results, indent=2) + "\n")
        return
    print_table([_column(name, place) for place, name in enumerate(results[0])], results)
    echo_line(f"page: {folder / 'index.html'}")


def _study(name: str) -> Callable[..., list[dict[str, Any]]]:
    try:
        run: Callable[..., list[dict[str, Any]]] = importlib.import_module(
            f"gem_train.studies.{name.replace('-', '_')}"
        ).run
    except ImportError as error:
        raise MissingRequirementError("gem train-study needs PyTorch: pip install 'gem-train[torch]'") from error
    return run


def _column(name: str, place: int) -> Column:
    def cell(row: dict[str, Any]) -> str:
        value = row[name]
        return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)

    return Column(name.replace("_", " "), cell, name=place == 0)
