"""The public names, which are imported on first use."""

from .code_env import CodeEnv as CodeEnv
