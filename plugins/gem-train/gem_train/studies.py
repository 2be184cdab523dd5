"""What a study needs beside its experiment: runs in several processes, kept as they end, and means over seeds."""

from __future__ import annotations

import json
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli import AtLeast, Column, print_table
from gem_core.errors import EnvFaultError
from gem_core.progress import Progress
from gem_train.reporting import mean_interval
from gem_train.reporting.metrics import cut_half_line, read_jsonl

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from gem_train.learner.options import TrainOptions
    from gem_train.learner.playing import Played
    from gem_train.learner.training import Training


def study_options(name: str, *, seeds: int = 5) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return what adds options to the command of a study, which is called with ``quick, seeds, workers, folder``.

    Args:
        name: The results are kept in ``runs/study-NAME`` by default.
        seeds: Runs of each setting by default; with ``--quick`` it is one.
    """

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        @click.option("-q", "--quick", is_flag=True, help="One seed, and if a study has them, fewer settings.")
        @click.option("--seeds", type=AtLeast(min=1), help=f"Runs of each setting.  [default: {seeds}; 1 with --quick]")
        @click.option("-w", "--workers", type=AtLeast(min=1), help="Runs at once.  [default: processors]")
        @click.option("-o", "--out", type=click.Path(file_okay=False), help=f"Folder.  [default: runs/study-{name}]")
        @wraps(command)
        def called(*, quick: bool, workers: int | None, out: str | None, **given: Any) -> Any:
            given["seeds"] = given["seeds"] or (1 if quick else seeds)
            folder = Path(out or f"runs/study-{name}{'-quick' if quick else ''}")
            return command(quick=quick, workers=workers, folder=folder, **given)

        return called

    return add


def run_all(
    run: Callable[..., dict[str, Any]],
    settings: Sequence[Mapping[str, Any]],
    folder: Path,
    *,
    workers: int | None = None,
) -> list[dict[str, Any]]:
    """Call ``run(**setting)`` for each setting, a few at once, and return each setting with its result.

    Results are kept in ``folder/results.jsonl`` as runs end, and a setting that is there is not run again: so delete
    that file when the study has changed.

    Args:
        run: A function of a module, since other processes import it; its result is plain JSON.
        settings: Its keyword arguments, plain JSON.
        folder: Made if it is missing.
        workers: Processes, of one thread each; None for one a processor.

    Raises:
        Exception: What a run raised; the results of those that ended before are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.jsonl"
    cut_half_line(path)
    kept = {_key(line["setting"]): line["result"] for line in read_jsonl(path)}
    waiting = [setting for setting in settings if _key(setting) not in kept]
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    processes = min(workers or processors, max(len(waiting), 1))
    with (
        path.open("a", encoding="utf-8") as file,
        Progress(len(waiting), folder.name, unit="runs") as progress,
        ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), _begin_worker) as pool,
    ):
        try:
            futures = {pool.submit(run, **setting): setting for setting in waiting}
            for done, future in enumerate(as_completed(futures), start=1):
                setting, result = futures[future], future.result()
                file.write(json.dumps({"setting": setting, "result": result}) + "\n")
                file.flush()
                kept[_key(setting)] = result
                progress.advance(done)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return [{**setting, **kept[_key(setting)]} for setting in settings]


def train_measured(
    options: TrainOptions, measure: Callable[[Training], dict[str, Any]], *, every: int = 0
) -> dict[str, Any]:
    """Train a policy from its warm start, and measure it on the way.

    Args:
        options: Of the run.
        measure: Returns plain values of the policy as it is; also called after the last update.
        every: Updates between measurements, the first before any update; 0 measures at the end only.

    Returns:
        ``curve``, the metrics of each update; ``measured``, what ``measure`` returned, with its ``update``; ``seconds``
        of the wall clock, the warm start left out.
    """
    from gem_train.learner.training import Training, warm_start

    curve, measured = [], []
    learner = warm_start(options)
    began = time.monotonic()
    with Training(learner) as training:
        for update in range(options.updates):
            if every and update % every == 0:
                measured.append({"update": update, **measure(training)})
            curve.append(training.update().metrics)
        measured.append({"update": options.updates, **measure(training)})
    return {"curve": curve, "measured": measured, "seconds": time.monotonic() - began}


def evaluated(training: Training, env_id: str | None = None) -> list[Played]:
    """Return the episodes of an evaluation without those that had an error.

    Raises:
        EnvFaultError: All of them had one.
    """
    played = [seat for seat in training.evaluate(env_id) if not seat.error]
    if not played:
        raise EnvFaultError(f"every episode of {env_id or training.options.env[0]} had an error; try 'gem run' on it")
    return played


def plot_seeds(axes: Axes, steps: Sequence[float], values: Sequence[Sequence[float]], label: str) -> None:
    """Draw the mean of several runs, (runs, steps), with the band of its 95 % interval."""
    mean, low, high = zip(*(mean_interval(of_step) for of_step in zip(*values, strict=True)), strict=True)
    [line] = axes.plot(steps, mean, label=label)
    if None not in low:
        axes.fill_between(steps, low, high, color=line.get_color(), alpha=0.2, linewidth=0)


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a table of rows that have the same names."""

    def cell(row: Mapping[str, Any], name: str) -> str:
        value = row[name]
        return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)

    print_table(
        [
            Column(name.replace("_", " "), lambda row, name=name: cell(row, name), name=place == 0)  # type: ignore[misc]
            for place, name in enumerate(rows[0])
        ],
        rows,
    )


def _key(setting: Mapping[str, Any]) -> str:
    return json.dumps(setting, sort_keys=True)


def _begin_worker() -> None:
    """Use one thread, and end as soon as the process that started this one has ended, even by a kill."""
    import torch

    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
    os._exit(1)
