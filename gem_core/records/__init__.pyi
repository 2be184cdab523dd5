"""The public names, which are imported on first use."""

from .conversation import History as History, Turn as Turn, split_observation as split_observation
from .episode import Episode as Episode, Transition as Transition, return_range_of as return_range_of
from .files import (
    EpisodeFileWarning as EpisodeFileWarning,
    EpisodeLine as EpisodeLine,
    EpisodeWriter as EpisodeWriter,
    episode_lines as episode_lines,
    read_episodes as read_episodes,
    read_records as read_records,
    whole_file as whole_file,
    write_episodes as write_episodes,
)
from .joint import JointEpisode as JointEpisode, Record as Record, record_from_dict as record_from_dict
from .plain_json import ImageFolder as ImageFolder, from_plain as from_plain, to_plain as to_plain
from .plans import (
    EpisodeStart as EpisodeStart,
    PlanItem as PlanItem,
    count_plan as count_plan,
    cover_plan as cover_plan,
    group_plan as group_plan,
    mixture_plan as mixture_plan,
)
from .redaction import without_secrets as without_secrets
from .summary import EnvSummary as EnvSummary, RunSummary as RunSummary
from .uncertainty import (
    Range as Range,
    effective_size as effective_size,
    shared_range as shared_range,
    standard_error as standard_error,
    wilson as wilson,
)
