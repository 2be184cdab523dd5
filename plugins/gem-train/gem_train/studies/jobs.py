"""Training runs of a study, a few at once, each in a process of its own; results that are there are not made again."""

from __future__ import annotations

import json
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from gem_core.env import stable_hash
from gem_core.progress import Progress
from gem_train.learner.options import TrainOptions
from gem_train.learner.training import Training

Setting = TypeVar("Setting", bound=Hashable)
"""What a study compares."""

Measure = Callable[[Training], dict[str, Any]]
"""A function of a module, since it is called in another process."""


@dataclass(frozen=True)
class Job:
    """A training run of a study.

    Args:
        name: Of its result, a file name.
        options: Of the run.
        measure: Called after the last update; what it returns, plain JSON, is a part of the result.
        every: Updates between calls of ``measure`` before that, which make a curve; 0 for none.
    """

    name: str
    options: TrainOptions
    measure: Measure
    every: int = 0


def run_jobs(
    settings: Mapping[Setting, Sequence[Job]], folder: Path, *, workers: int | None = None, quiet: bool = False
) -> dict[Setting, list[dict[str, Any]]]:
    """Run what is not there yet, and return the results of each setting in the order of its jobs.

    A result has ``"options"``, ``"seconds"`` (of the wall clock, the warm start left out), ``"curve"`` (the metrics of
    each update) and ``"measured"``, a list of what ``measure`` returned with the ``"update"`` of each.

    Args:
        settings: The jobs of each setting, one a seed. The first of all settings are begun before the second.
        folder: Where results and warm starts are kept.
        workers: Processes; None for one a processor.
        quiet: Show no progress.

    Raises:
        Exception: What a job raised; the results of the others are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    waiting = [job for of_seed in zip(*settings.values(), strict=True) for job in of_seed if not _result(folder, job)]
    starts = {_start_file(folder, job.options): job for job in waiting}
    tasks: list[tuple[Callable[[Job, Path], None], Job]] = [
        (_make_start, job) for path, job in starts.items() if not path.exists()
    ]
    context = multiprocessing.get_context("spawn")
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    size = min(workers or processors, max(len(waiting), 1))
    with (
        Progress(len(waiting), folder.name, unit="runs", quiet=quiet) as progress,
        ProcessPoolExecutor(size, mp_context=context, initializer=_end_with_parent) as pool,
    ):
        try:
            starting = [pool.submit(make, job, folder) for make, job in tasks]
            _finish(starting, lambda done: progress.advance(0, f"{done} of {len(tasks)} warm starts"))
            _finish([pool.submit(_run, job, folder) for job in waiting], progress.advance)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return {setting: [_result(folder, job) for job in jobs] for setting, jobs in settings.items()}


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, even by a kill."""

    def wait_for_parent() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_parent, daemon=True).start()


def _finish(futures: list[Future[None]], on_done: Callable[[int], None]) -> None:
    left = set(futures)
    while left:
        done, left = wait(left, timeout=1.0, return_when=FIRST_COMPLETED)
        for future in done:
            future.result()
        on_done(len(futures) - len(left))


def _result(folder: Path, job: Job) -> dict[str, Any]:
    """Return a job's result; it is empty if it is not there, or of other options."""
    path = folder / f"{job.name}.json"
    if not path.exists():
        return {}
    result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return result if result["options"] == json.loads(json.dumps(job.options.to_dict())) else {}


def _start_file(folder: Path, options: TrainOptions) -> Path:
    """Return where the warm start of a run is kept: runs that differ in the algorithm alone share it."""
    own = {"algorithm", "gamma", "lam", "updates", "episodes", "group_size", "epochs", "minibatches", "learning_rate"}
    own |= {"clip", "entropy", "value_weight", "overlap", "eval_every", "eval_episodes", "checkpoint_every"}
    own |= {"failure_reward", "role_baselines"}
    shared = {name: value for name, value in options.to_dict().items() if name not in own}
    return folder / f"start-{stable_hash(json.dumps(shared, sort_keys=True))}.pt"


def _make_start(job: Job, folder: Path) -> None:
    import torch

    from gem_train.learner.training import warm_start

    torch.set_num_threads(1)
    learner = warm_start(job.options)
    state = {"words": learner.vocabulary.words, "policy": learner.policy.state_dict()}
    _replace(_start_file(folder, job.options), lambda path: torch.save(state, path))


def _run(job: Job, folder: Path) -> None:
    import torch

    from gem_train.learner.learning import Learner
    from gem_train.learner.vocabulary import Vocabulary

    torch.set_num_threads(1)
    start = torch.load(_start_file(folder, job.options), weights_only=True)
    learner = Learner(job.options, Vocabulary(start["words"]))
    learner.policy.load_state_dict(start["policy"])
    curve, measured = [], []
    began = time.monotonic()
    with Training(learner) as training:
        for update in range(1, job.options.updates + 1):
            if job.every and (update - 1) % job.every == 0:
                measured.append({"update": update - 1, **job.measure(training)})
            curve.append(training.update().metrics)
        seconds = time.monotonic() - began
        measured.append({"update": job.options.updates, **job.measure(training)})
    result = {"options": job.options.to_dict(), "seconds": seconds, "curve": curve, "measured": measured}
    _replace(folder / f"{job.name}.json", lambda path: path.write_text(json.dumps(result), encoding="utf-8"))


def _replace(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file under another name first, so that it is there whole or not at all."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    write(part)
    part.replace(path)
