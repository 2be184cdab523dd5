"""The public names, which are imported on first use."""

from .chat import ConcatChat as ConcatChat, MessagesView as MessagesView
from .episode_stats import EpisodeStats as EpisodeStats
from .turn_limit import TurnLimit as TurnLimit
from .views import (
    Concat as Concat,
    ConcatWithAction as ConcatWithAction,
    Latest as Latest,
    ObservationView as ObservationView,
)
