"""The public names, which are imported on first use."""

from .endpoint import Endpoint as Endpoint
from .harness import Harness as Harness
