"""Records of episodes: transitions, the conversation, files, plans, and scores."""

from __future__ import annotations

from gem_core.parsing import without_thinking
from gem_core.records.conversation import History, Turn, split_observation
from gem_core.records.episode import Episode, Transition, return_range_of
from gem_core.records.files import (
    EpisodeFileWarning,
    EpisodeLine,
    EpisodeWriter,
    episode_lines,
    lock_holder,
    read_episodes,
    read_records,
    write_episodes,
)
from gem_core.records.joint import JointEpisode, Record, record_from_dict
from gem_core.records.plain_json import ImageFolder, from_plain, to_plain
from gem_core.records.plans import EpisodeStart, PlanItem, count_plan, cover_plan, group_plan, mixture_plan
from gem_core.records.redaction import without_secrets
from gem_core.records.summary import EnvSummary, RunSummary
from gem_core.records.uncertainty import Range, effective_size, shared_range, standard_error, wilson

__all__ = [
    "EnvSummary",
    "Episode",
    "EpisodeFileWarning",
    "EpisodeLine",
    "EpisodeStart",
    "EpisodeWriter",
    "History",
    "ImageFolder",
    "JointEpisode",
    "PlanItem",
    "Range",
    "Record",
    "RunSummary",
    "Transition",
    "Turn",
    "count_plan",
    "cover_plan",
    "effective_size",
    "episode_lines",
    "from_plain",
    "group_plan",
    "lock_holder",
    "mixture_plan",
    "read_episodes",
    "read_records",
    "record_from_dict",
    "return_range_of",
    "shared_range",
    "split_observation",
    "standard_error",
    "to_plain",
    "wilson",
    "without_secrets",
    "without_thinking",
    "write_episodes",
]
