"""The public names, which are imported on first use."""

from .completions import Completion as Completion, completions as completions
from .from_episodes import batches as batches
from .token_batch import TokenBatch as TokenBatch
