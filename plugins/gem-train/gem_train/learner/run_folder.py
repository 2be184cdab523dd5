"""The folder of a run: options, metrics, samples of episodes, the last checkpoint, curves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from gem_core.errors import ArgumentError
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.playing import Played, text_of
from gem_train.reporting import plot_run, truncate_jsonl

_SAMPLES = 2


class RunFolder:
    """What a run keeps, and goes on from.

    Args:
        path: Of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._options, self._checkpoint = self.path / "options.json", self.path / "checkpoint.pt"
        self._samples = self.path / "samples.jsonl"

    def options(self) -> TrainOptions:
        """Return the options of the run that is here.

        Raises:
            ArgumentError: There is none.
        """
        if not self._options.exists():
            raise ArgumentError(f"{self.path} holds no run: it has no options.json")
        return TrainOptions.from_dict(json.loads(self._options.read_text(encoding="utf-8")))

    def begin(self, options: TrainOptions) -> None:
        """Keep the options; where there is a checkpoint, check that it has the same.

        Raises:
            ArgumentError: Some are others, or cannot be kept as JSON.
        """
        given = options.to_dict()
        if not self._checkpoint.exists():
            self.path.mkdir(parents=True, exist_ok=True)
            self._options.write_text(json.dumps(given, indent=1) + "\n", encoding="utf-8")
            return
        there = self.options().to_dict()
        others = [
            f"{name} is {there[name]!r} there, not {value!r}" for name, value in given.items() if there[name] != value
        ]
        if others:
            raise ArgumentError(
                f"{self.path} holds a run with other options: {'; '.join(others)}. Go on with it by "
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

    def add_samples(self, update: int, played: Sequence[Played]) -> None:
        """Append some of the episodes of an update, for a person to read."""
        with self._samples.open("a", encoding="utf-8") as file:
            for seat in [seat for seat in played if seat.turns][:_SAMPLES]:
                turns = [
                    {"observation": text_of(turn.shown), "response": turn.text, "reward": turn.reward}
                    for turn in seat.turns
                ]
                line = {"update": update, "return": seat.episode_return, "seat": seat.seat, "episode": turns}
                file.write(json.dumps(line) + "\n")

    def truncate_samples(self, update: int) -> None:
        """Remove the samples of later updates."""
        truncate_jsonl(self._samples, update)

    def draw(self) -> None:
        """Write ``curves.png``."""
        plot_run(self.path)
