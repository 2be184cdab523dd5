"""The curves of a run, and intervals over seeds."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from gem_train.reporting import MetricsLog, mean_interval, plot_run


@pytest.mark.parametrize(
    "metrics",
    [
        [],
        [{"return": 0.5}],
        [{"return": float("nan")}] * 2,
        [{"other": 1.0}],
        [{"eval/Sudoku/return": 1.0}],
        [{"return": update / 100, "success": 0.5, "eval/return": 1.0} for update in range(100)],
    ],
    ids=["none", "one update", "no finite one", "an unknown one", "only an evaluation", "a long run"],
)
def test_curves_are_drawn_of_any_run(tmp_path: Path, metrics: list[dict[str, float]]):
    """Of one that has only begun too."""
    pytest.importorskip("matplotlib")
    log = MetricsLog(tmp_path)
    for update, values in enumerate(metrics):
        log.write(update, values)
    log.close()
    assert plot_run(tmp_path).read_bytes().startswith(b"\x89PNG")


def test_logging_does_not_load_matplotlib():
    """Neither `import gem_train` nor its log of metrics waits for matplotlib."""
    code = "import gem_train, sys; from gem_train.reporting import MetricsLog; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "False"


def test_interval_is_students():
    """Five seeds, as of a study; 2.776 is the quantile of four degrees of freedom in any table."""
    pytest.importorskip("scipy")
    mean, low, high = mean_interval([4.0, 5.0, 5.0, 5.0, 6.0])
    half = 2.776445 * math.sqrt(0.5) / math.sqrt(5)
    assert (mean, low, high) == pytest.approx((5.0, 5.0 - half, 5.0 + half))


def test_fewer_than_two_values_tell_no_spread():
    """The interval of one seed is unknown, not of width 0."""
    pytest.importorskip("scipy")
    assert mean_interval([0.5]) == (0.5, None, None)
    found = mean_interval([])
    assert math.isnan(found.mean)
    assert found[1:] == (None, None)
