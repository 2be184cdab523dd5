"""The public names, which are imported on first use."""

from .terminal_env import TerminalEnv as TerminalEnv
