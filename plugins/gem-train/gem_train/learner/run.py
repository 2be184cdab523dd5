"""``train``: a run from its first update, or from its last checkpoint, to the end, kept in a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import torch

from gem_train.learner.options import TrainOptions
from gem_train.learner.run_folder import RunFolder
from gem_train.learner.training import Training, describe, warm_start
from gem_train.reporting import MetricsLog, read_metrics


def train(
    options: TrainOptions,
    folder: str | Path,
    *,
    tensorboard: bool = False,
    wandb: str | None = None,
    on_imitation: Callable[[int, float], None] = lambda step, loss: None,
    on_update: Callable[[int, dict[str, float]], None] = lambda update, metrics: None,
) -> dict[str, float | None]:
    """Train a policy, and keep the run in a folder; a run that is there goes on from its last checkpoint.

    A run that was stopped, by Ctrl-C or an error, has a checkpoint of its last update, and ends as if it had never been
    stopped: the same metrics (but for ``seconds``) and weights to the last bit, where environments repeat themselves
    and the machine and the number of threads are the same. With ``overlap`` it does not: the batch that was being
    played is played anew, by newer weights.

    Args:
        options: Of the run.
        folder: ``options.json``, ``metrics.jsonl``, ``samples.jsonl``, ``checkpoint.pt``, ``curves.png``.
        tensorboard: Whether to write for TensorBoard as well.
        wandb: A project of Weights & Biases to log to as well.
        on_imitation: Called with the number of each step of imitation, from 0, and its loss.
        on_update: Called with the number of each update, from 1, and its metrics.

    Returns:
        The metrics of the last update, with those of the evaluation after it.

    Raises:
        ArgumentError: The folder holds a run with other options.
    """
    run = RunFolder(folder)
    run.begin(options)
    with _threads(options.threads), closing(MetricsLog(folder, tensorboard, wandb)) as log:
        learner = run.load()
        if learner is None:
            learner = warm_start(options, on_imitation)
            run.save(learner.state())
        log.truncate_after(learner.updates)
        run.truncate_samples(learner.updates)
        state = learner.state()
        try:
            with Training(learner) as training:
                while learner.updates < options.updates:
                    metrics = _update(training, run)
                    log.write(learner.updates, metrics)
                    state = learner.state()
                    if _is_due(learner.updates, options.checkpoint_every, options):
                        run.save(state)
                        if learner.updates < options.updates:
                            run.draw()
                    on_update(learner.updates, metrics)
        except BaseException:
            run.save(state)
            raise
    run.draw()
    return read_metrics(folder)[-1]


def _update(training: Training, run: RunFolder) -> dict[str, float]:
    """Make an update and what is due after it, and return all metrics."""
    options, started = training.options, time.perf_counter()
    metrics, played = training.update()
    metrics["seconds"] = time.perf_counter() - started
    updates = training.learner.updates
    if updates == 1 or _is_due(updates, options.checkpoint_every, options):
        run.add_samples(updates, played)
    if _is_due(updates, options.eval_every, options):
        ids = options.eval_envs or tuple(dict.fromkeys(options.env))
        for env_id in ids:
            name = "eval" if len(ids) == 1 and ids == options.env else f"eval/{env_id}"
            evaluated = describe(training.evaluate(env_id))
            metrics |= {f"{name}/{metric}": value for metric, value in evaluated.items()}
    return metrics


def _is_due(update: int, every: int, options: TrainOptions) -> bool:
    return update == options.updates or (every > 0 and update % every == 0)


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Let torch use so many threads; 0 leaves it as it is."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
