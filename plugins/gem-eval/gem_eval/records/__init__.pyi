"""The public names, which are imported on first use."""

from .row import Row as Row
from .run import Run as Run, open_run as open_run, read_info as read_info
from .writer import RunWriter as RunWriter
