"""The study of transfer: what is imitated, and a tiny run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")

from gem_train.learner.options import TrainOptions
from gem_train.learner.training import warm_start
from gem_train.studies import transfer

options_of = transfer.options_of
TINY: dict[str, Any] = {"updates": 1, "episodes": 4, "eval_episodes": 6, "width": 8, "heads": 2}
TINY |= {"imitate_episodes": 8, "imitate_steps": 2}


def tiny_options(trained: str, seed: int) -> TrainOptions:
    return replace(options_of(trained, seed), **TINY)


def test_evaluations_are_in_the_vocabulary_and_not_imitated() -> None:
    """The player of GuessTheNumber could not play Mastermind; but what Mastermind says can be read."""
    learner = warm_start(tiny_options("one range", 0))
    assert any("Mastermind" in word for word in learner.vocabulary.words)


@pytest.mark.thorough
def test_study_runs_from_imitation_to_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the smallest size, on one seed."""
    monkeypatch.setattr(transfer, "options_of", tiny_options)
    rows = transfer.run(tmp_path, quick=True, seeds=1, workers=1, quiet=True)
    assert [(row["trained"], row["evaluated"]) for row in rows] == [
        (trained, evaluated) for trained in transfer.TRAINED.values() for evaluated in transfer.EVALUATED.values()
    ]
    assert all(0 <= row["success"] <= 1 for row in rows)
    assert "Mastermind" in (tmp_path / "index.html").read_text(encoding="utf-8")
