"""The public names, which are imported on first use."""

from .curves import plot_run as plot_run
from .figures import (
    Bar as Bar,
    Curve as Curve,
    bars_with_intervals as bars_with_intervals,
    curves_with_bands as curves_with_bands,
    first_guesses as first_guesses,
)
from .intervals import Interval as Interval, mean_interval as mean_interval
from .metrics import MetricsLog as MetricsLog, read_metrics as read_metrics, truncate_jsonl as truncate_jsonl
from .pages import write_page as write_page, write_study_page as write_study_page
