"""``train``: a run from its first update, or from its last checkpoint, to the end; ``RunFolder`` keeps it."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Collection
from contextlib import closing
from pathlib import Path
from typing import Any

import torch

from gem_core.errors import ArgumentError
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.training import Training, describe, warm_start
from gem_train.reporting import MetricsLog, plot_run, read_metrics

_logger = logging.getLogger(__name__)


def train(
    options: TrainOptions,
    folder: str | Path,
    *,
    named: Collection[str] = (),
    tensorboard: bool = False,
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
        folder: ``options.json``, ``metrics.jsonl``, ``checkpoint.pt``, ``curves.png``.
        named: Options that were given; see ``RunFolder.begin``.
        tensorboard: Whether to write for TensorBoard as well; a run that did so goes on to.
        on_imitation: Called with the number of each step of imitation, from 0, and its loss.
        on_update: Called with the number of each update, from 1, and its metrics.

    Returns:
        The metrics of the last update, with those of the evaluation after it.

    Raises:
        ArgumentError: The folder holds a run with other options.
    """
    run = RunFolder(folder)
    run.begin(options, named)
    if options.threads:
        torch.set_num_threads(options.threads)
    tensorboard = tensorboard or (run.path / "tensorboard").exists()  # a run goes on as it began
    with closing(MetricsLog(folder, tensorboard)) as log:
        learner = run.load()
        if learner is None:
            learner = warm_start(options, on_imitation)
            run.save(learner.state())
        log.truncate_after(learner.updates)
        state = learner.state()
        try:
            with Training(learner) as training:
                while learner.updates < options.updates:
                    metrics = _update(training)
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


def _update(training: Training) -> dict[str, float]:
    """Make an update and what is due after it, and return all metrics."""
    options, started = training.options, time.perf_counter()
    metrics, played = training.update()
    longest = max((len(seat.turns[0].shown_ids) for seat in played if seat.turns), default=0)
    room = options.context - options.max_tokens
    if training.learner.updates == 1 and longest > room:
        told = "a task of %d tokens loses its beginning, perhaps its rules: --context %d leaves %d"
        _logger.warning(told, longest, options.context, room)
    metrics["seconds"] = time.perf_counter() - started
    if _is_due(training.learner.updates, options.eval_every, options):
        ids = options.eval_envs or tuple(dict.fromkeys(options.env))
        for env_id in ids:
            name = "eval" if len(ids) == 1 and ids == options.env else f"eval/{env_id}"
            evaluated = describe(training.evaluate(env_id))
            metrics |= {f"{name}/{metric}": value for metric, value in evaluated.items()}
    return metrics


def _is_due(update: int, every: int, options: TrainOptions) -> bool:
    return update == options.updates or (every > 0 and update % every == 0)


class RunFolder:
    """What a run keeps, and goes on from.

    Args:
        path: Of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._options, self._checkpoint = self.path / "options.json", self.path / "checkpoint.pt"

    def options(self) -> TrainOptions:
        """Return the options of the run that is here.

        Raises:
            ArgumentError: There is none.
        """
        if not self._options.exists():
            raise ArgumentError(f"{self.path} holds no run: it has no options.json")
        return TrainOptions.from_dict(json.loads(self._options.read_text(encoding="utf-8")))

    def begin(self, options: TrainOptions, named: Collection[str] = ()) -> None:
        """Keep the options; where there is a checkpoint, check that it has the same.

        Args:
            options: Of the run.
            named: Those that were given; if one of them differs, the defaults of the others are not told.

        Raises:
            ArgumentError: Some are others, or cannot be kept as JSON.
        """
        given = options.to_dict()
        if not self._checkpoint.exists():
            self.path.mkdir(parents=True, exist_ok=True)
            self._options.write_text(json.dumps(given, indent=1) + "\n", encoding="utf-8")
            return
        there = self.options().to_dict()
        others = [name for name, value in given.items() if there[name] != value]
        if "algorithm" in others:  # these follow it
            others = [name for name in others if name not in ("group_size", "epochs", "minibatches")]
        if others:
            others = [name for name in others if name in named] or others
            told = "; ".join(f"{name} is {there[name]!r} there, not {given[name]!r}" for name in others)
            raise ArgumentError(
                f"{self.path} holds a run with other options: {told}. Go on with it by "
                f"'gem train --resume {self.path}', or name another folder"
            )

    def save(self, state: dict[str, Any]) -> None:
        """Replace the checkpoint by what ``Learner.state`` returned; it is never half written."""
        unfinished = self._checkpoint.with_suffix(".partial")
        torch.save(state, unfinished)
        unfinished.replace(self._checkpoint)

    def load(self) -> Learner | None:
        """Return the learner as it was at the last checkpoint; None where there is none yet."""
        if not self._checkpoint.exists():
            return None
        return Learner.restored(torch.load(self._checkpoint, weights_only=True))

    def draw(self) -> None:
        """Write ``curves.png``."""
        plot_run(self.path)
