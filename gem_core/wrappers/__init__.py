"""Wrappers that come with the core: observation views, chat, limits, statistics.

A new one gets a file here and a record in ``gem_core/_plugin.py``.
"""

from __future__ import annotations

from gem_core.wrappers.chat import ConcatChat, MessagesView
from gem_core.wrappers.episode_stats import EpisodeStats
from gem_core.wrappers.turn_limit import TurnLimit
from gem_core.wrappers.views import Concat, ConcatWithAction, Latest, ObservationView

__all__ = [
    "Concat",
    "ConcatChat",
    "ConcatWithAction",
    "EpisodeStats",
    "Latest",
    "MessagesView",
    "ObservationView",
    "TurnLimit",
]
