"""The log of a run's metrics: values in, lines out."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gem_core.errors import MissingRequirementError
from gem_train.reporting import MetricsLog, read_metrics, truncate_jsonl


def lines(folder: Path) -> list[Any]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_each_update_is_a_line_at_once(tmp_path: Path):
    """A line can be read before the log is closed; what JSON does not know is null."""
    log = MetricsLog(tmp_path / "run")
    log.write(1, {"return": 0.5, "loss": float("nan"), "kl": float("-inf")})
    assert lines(tmp_path / "run") == [{"update": 1, "return": 0.5, "loss": None, "kl": None}]
    log.write(2, {"return": 1})
    log.close()
    assert read_metrics(tmp_path / "run")[1] == {"update": 2, "return": 1.0}


def test_half_written_last_line_is_dropped(tmp_path: Path):
    """A killed process leaves half a line: it is not read, and what is written next does not stick to it."""
    (tmp_path / "metrics.jsonl").write_text('{"update": 1, "loss": 2.0}\n{"update": 2, "lo')
    assert read_metrics(tmp_path) == [{"update": 1, "loss": 2.0}]
    log = MetricsLog(tmp_path)
    log.write(2, {"loss": 1.0})
    log.close()
    assert lines(tmp_path) == [{"update": 1, "loss": 2.0}, {"update": 2, "loss": 1.0}]


def test_no_file_is_no_metrics(tmp_path: Path):
    assert read_metrics(tmp_path) == []


def test_resuming_removes_later_updates(tmp_path: Path):
    """After a resume the file is that of a run that never went further than the checkpoint."""
    log = MetricsLog(tmp_path)
    for update in range(1, 6):
        log.write(update, {"loss": update})
    log.truncate_after(3)
    log.write(4, {"loss": 40})
    log.close()
    assert [(line["update"], line["loss"]) for line in lines(tmp_path)] == [(1, 1), (2, 2), (3, 3), (4, 40)]


def test_truncating_a_missing_file_does_nothing(tmp_path: Path):
    truncate_jsonl(tmp_path / "samples.jsonl", 3)
    assert not (tmp_path / "samples.jsonl").exists()


def test_tensorboard_has_the_same_numbers(tmp_path: Path):
    """TensorBoard's own reader finds each metric, and after a resume no later update."""
    reading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    log = MetricsLog(tmp_path, tensorboard=True)
    for update in (1, 2, 3):
        log.write(update, {"return": update / 2})
    log.truncate_after(2)
    log.write(3, {"return": 7.0})
    log.close()
    events = reading.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(event.step, event.value) for event in events.Scalars("return")] == [(1, 0.5), (2, 1.0), (3, 7.0)]


@pytest.mark.parametrize(
    ("missing", "option", "advice"),
    [
        ("torch.utils.tensorboard", {"tensorboard": True}, r"pip install 'gem-train\[tensorboard\]'"),
        ("wandb", {"wandb": "gem"}, r"pip install 'gem-train\[wandb\]'"),
    ],
)
def test_missing_package_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str, option: dict[str, Any], advice: str
):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(MissingRequirementError, match=advice):
        MetricsLog(tmp_path, **option)


def test_wandb_gets_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The run is of the project that was named, in the group of the folder, and is finished at the end."""
    calls: list[Any] = []
    run = SimpleNamespace(log=lambda values, step: calls.append((step, values)), finish=lambda: calls.append("finish"))
    stand_in = SimpleNamespace(init=lambda **options: calls.append(options) or run)
    monkeypatch.setitem(sys.modules, "wandb", stand_in)
    log = MetricsLog(tmp_path / "run", wandb="gem")
    log.write(1, {"return": 0.5})
    log.close()
    assert calls == [
        {"project": "gem", "group": "run", "dir": str(tmp_path / "run")},
        (1, {"return": 0.5}),
        "finish",
    ]
