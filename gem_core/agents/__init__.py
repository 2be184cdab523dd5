"""Agents that come with the core; a new one gets a file here, and a record in ``gem_core/_plugin.py``."""

from gem_core.agents.human import AnswerForm, HumanAgent
from gem_core.agents.random import RandomAgent

__all__ = ["AnswerForm", "HumanAgent", "RandomAgent"]
