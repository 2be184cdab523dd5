"""What a run leaves behind: its log of metrics, curves, and intervals over seeds."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.errors import MissingRequirementError
from gem_train.reporting import MetricsLog, mean_interval, plot_run, read_metrics


def write(folder: Path, *metrics: dict[str, float], first: int = 1) -> None:
    log = MetricsLog(folder)
    for update, values in enumerate(metrics, start=first):
        log.write(update, values)
    log.close()


def test_each_update_is_a_line_at_once(tmp_path: Path):
    """It can be read before the log is closed; what JSON does not know is null; half a line of a killed run is cut."""
    assert read_metrics(tmp_path) == []
    (tmp_path / "metrics.jsonl").write_text('{"update": 1, "loss": 2.0}\n{"update": 2, "lo')
    assert read_metrics(tmp_path) == [{"update": 1, "loss": 2.0}]
    log = MetricsLog(tmp_path)
    log.write(2, {"loss": float("nan"), "kl": float("-inf")})
    assert read_metrics(tmp_path) == [{"update": 1, "loss": 2.0}, {"update": 2, "loss": None, "kl": None}]
    log.close()


def test_resuming_removes_later_updates_from_file_and_tensorboard(tmp_path: Path):
    """As in a run that never went further than the checkpoint, read by TensorBoard's own reader."""
    reading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    log = MetricsLog(tmp_path, tensorboard=True)
    for update in (1, 2, 3):
        log.write(update, {"return": update / 2})
    log.truncate_after(2)
    log.write(3, {"return": 7.0})
    log.close()
    expected = [(1, 0.5), (2, 1.0), (3, 7.0)]
    assert [(line["update"], line["return"]) for line in read_metrics(tmp_path)] == expected
    events = reading.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(event.step, event.value) for event in events.Scalars("return")] == expected


def test_missing_tensorboard_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingRequirementError, match=r"gem-train\[tensorboard\]"):
        MetricsLog(tmp_path, tensorboard=True)


@pytest.mark.parametrize(
    "metrics",
    [
        [],
        [{"return": float("nan")}] * 2,
        [{"other": 1.0}],
        [{"eval/Sudoku/return": 1.0}],
        [{"return": update / 100, "success": 0.5, "eval/return": 1.0} for update in range(100)],
    ],
    ids=["none", "no finite one", "an unknown one", "only an evaluation", "a long run"],
)
def test_curves_are_drawn_of_any_run(tmp_path: Path, metrics: list[dict[str, float]]):
    pytest.importorskip("matplotlib")
    write(tmp_path, *metrics)
    assert plot_run(tmp_path).read_bytes().startswith(b"\x89PNG")


def test_logging_does_not_load_matplotlib():
    code = "import gem_train, sys; from gem_train.reporting import MetricsLog; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "False"


def test_interval_is_students():
    """Five seeds; 2.776 is the quantile of four degrees of freedom in any table. One seed tells no spread."""
    pytest.importorskip("scipy")
    half = 2.776445 * math.sqrt(0.5) / math.sqrt(5)
    assert mean_interval([4.0, 5.0, 5.0, 5.0, 6.0]) == pytest.approx((5.0, 5.0 - half, 5.0 + half))
    assert mean_interval([0.5]) == (0.5, None, None)
    assert math.isnan(mean_interval([]).mean)
