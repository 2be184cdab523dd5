"""The public names, which are imported on first use."""

from .env import QAEnv as QAEnv
