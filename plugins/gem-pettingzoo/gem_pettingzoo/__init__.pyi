"""The public names, which are imported on first use."""

from .exports import to_aec as to_aec, to_parallel as to_parallel
from .imports import PettingZooEnv as PettingZooEnv, from_pettingzoo as from_pettingzoo
