from .curves import plot_run as plot_run
from .intervals import Interval as Interval, mean_interval as mean_interval
from .metrics import MetricsLog as MetricsLog, read_metrics as read_metrics
