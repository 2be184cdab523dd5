"""``Transition`` and ``Episode``: the record of an episode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sized
from dataclasses import dataclass, field, replace
from typing import Any

from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records.conversation import Conversation
from gem_core.records.plain_json import ImageFolder, from_plain, to_plain
from gem_core.records.redaction import without_secrets
from gem_core.types import Info, Observation, Response

SCHEMA_VERSION = 1

_LONG_ARGUMENT = 2000


@dataclass
class Transition:
    """One turn.

    Args:
        observation: The environment's observation; ``Episode.sent`` returns the part that the agent was sent.
        action: The response, to the letter.
        reward: Reward of this turn.
        terminated: Whether the task was over with it.
        truncated: Whether the episode was cut off after it.
        info: The info that ``step`` returned.
    """

    observation: Observation
    action: Response
    reward: float
    terminated: bool
    truncated: bool
    info: Info


@dataclass(eq=False)
class Episode:
    """The record of one episode and of its start, from which it can be replayed.

    Args:
        id: Id of the environment, or the name of its class.
        seed: Seed of the episode.
        observation: The first observation.
        info: The info that ``reset`` returned.
        transitions: The turns in order; none if the reset failed.
        final_observation: The observation of the last step.
        kwargs: Keyword arguments of the environment, which override the registered ones. A file leaves long ones out,
            as the rows of a data set, and blots out secrets.
        wrappers: Names and options of its wrappers, innermost first. In a file, secrets are blotted out.
        tools: Names of its tools.
        options: The options of ``reset``.
        group: Shared by episodes that started alike.
        key: The item's place in the plan.
        repeat: Which of the item's episodes it is, from 0.
        reads: Form of the history that the agent was sent: ``"messages"``, ``"observation"`` or
            ``"concat_with_action"``; see ``sent``. None if unknown, as in files of earlier versions.
        system: The agent's own system text, which goes before the task's.
        native_tools: Whether the agent was offered the tools as schemas, so that no text explains them.
        run_seed: Seed of the run.
        versions: Version of each distribution that took part.
        seat: Name of the agent's seat among several; None if it was alone. See ``JointEpisode``.
        agent: Name of the agent that acted; None if unknown, as in files of earlier versions.
        first_reward: Reward that came with the first observation, for actions of others; 0 for an agent alone.
        ended_first: Whether the task was over for a seat among several before it ever acted.
        return_range: The lowest and the highest return that the environment declares; None if it declares none.
        schema_version: Version of this record's form.
    """

    id: str
    seed: int | None
    observation: Observation
    info: Info
    transitions: list[Transition] = field(default_factory=list)
    final_observation: Observation = ""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    wrappers: list[Any] = field(default_factory=list)
    tools: list[str] = field(default_factory=list)
    options: Mapping[str, Any] | None = None
    group: str | None = None
    key: str = "0"
    repeat: int = 0
    reads: str | None = None
    system: str | None = None
    native_tools: bool = False
    run_seed: int | None = None
    versions: dict[str, str] = field(default_factory=dict)
    seat: str | None = None
    agent: str | None = None
    first_reward: float = 0.0
    ended_first: bool = False
    return_range: tuple[float, float] | None = None
    schema_version: int = SCHEMA_VERSION

    @property
    def final_info(self) -> Info:
        """The info of the last step, or of the reset if there was none."""
        return self.transitions[-1].info if self.transitions else self.info

    @property
    def turns(self) -> int:
        """Number of turns."""
        return len(self.transitions)

    @property
    def episode_return(self) -> float:
        """Sum of the rewards, undiscounted."""
        return sum((transition.reward for transition in self.transitions), self.first_reward)

    @property
    def messages(self) -> list[dict[str, Any]]:
        """The conversation as chat messages, whatever the agent was sent: system text first, tool results under ids."""
        return Conversation(self).messages()

    def sent(self, turn: int) -> Observation:
        """Return what the agent was sent to answer in a turn, from 0: messages, or an observation.

        What a model was sent with an observation, its ``system`` text and the tools, is not in it.

        Raises:
            IndexError: There is no such turn.
        """
        asked = self.transitions[turn].observation
        before = self.transitions[: range(self.turns)[turn]]
        return Conversation(replace(self, transitions=before, final_observation=asked)).sent()

    @property
    def success(self) -> bool | None:
        """Whether the task was solved, as ``info["correct"]`` says at the end.

        False for an episode that was cut off without a verdict. None, for unknown, after an error; if the task ended
        without a verdict; and if ``reset`` gave ``info["correct"] = None``, as a task does that never has one.
        """
        correct = self.final_info.get("correct")
        if self.error is not None:
            return None
        if correct is not None:
            return bool(correct)
        return None if self._ended or self.info.get("correct", False) is None else False

    @property
    def cut_off(self) -> str | None:
        """The limit that cut the episode off; None for one that ended by itself or in an error.

        ``"tokens"``: its context overflowed, or its last response stopped at the model's token limit, whether or not
        the task ended with it. ``"turns"``: a limit of turns, or any other reason of the environment's. Another limit
        has its name, as ``"time"`` or ``"cost"``; see ``EpisodeLimitError``.
        """
        if self.error is not None:
            return None
        last = self.transitions[-1] if self.transitions else None
        if (last is not None and last.action.cut_off) or (not self._ended and self.final_info.get("context_overflow")):
            return "tokens"
        return None if self._ended else str(self.final_info.get("cut_off") or "turns")

    @property
    def unreadable(self) -> bool:
        """Whether the last response held nothing that the task could read: ``info["parsed_action"]`` is None."""
        return bool(self.transitions) and self.transitions[-1].info.get("parsed_action", "") is None

    @property
    def _ended(self) -> bool:
        """Whether the task itself was over at the end."""
        return self.transitions[-1].terminated if self.transitions else self.ended_first

    @property
    def error(self) -> dict[str, Any] | None:
        """The failure of the environment or a server, not of the agent; None for an episode that counts."""
        error = self.final_info.get("error")
        return error if error is None or isinstance(error, dict) else {"kind": "unknown", "message": str(error)}

    def to_dict(self, images: ImageFolder | None = None) -> dict[str, Any]:
        """Return the episode as plain JSON.

        Args:
            images: The folder for images; None leaves their content out.
        """
        fields = {name: value for name, value in vars(self).items() if name != "transitions"}
        # Long collections go before they are converted: a data set would take seconds for every episode.
        fields["kwargs"] = {
            name: value
            for name, value in self.kwargs.items()
            if not isinstance(value, Sized) or len(value) <= _LONG_ARGUMENT
        }
        record = {name: to_plain(value, images) for name, value in fields.items()}
        kept = {name: value for name, value in record["kwargs"].items() if len(str(value)) <= _LONG_ARGUMENT}
        # Files are shared with other people.
        record["kwargs"], record["wrappers"] = without_secrets(kept), without_secrets(record["wrappers"])
        record["transitions"] = [
            {
                "observation": to_plain(turn.observation, images),
                "action": {"text": to_plain(turn.action.text), **to_plain(turn.action.reported(), images)},
                "reward": turn.reward,
                "terminated": turn.terminated,
                "truncated": turn.truncated,
                "info": to_plain(turn.info, images),
            }
            for turn in self.transitions
        ]
        return record

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], images: ImageFolder | None = None) -> Episode:
        """Return the episode that ``to_dict`` wrote.

        Raises:
            EpisodeFileError: It is no record of an episode, or of a later form than this version reads.
        """
        version = record.get("schema_version") if isinstance(record, Mapping) else None
        if not isinstance(version, int) or version < 1:
            raise EpisodeFileError("it is no record of an episode: there is no schema_version")
        if version > SCHEMA_VERSION:
            raise EpisodeFileError(f"it has form {version}, and this version reads {SCHEMA_VERSION}; upgrade gem-core")
        try:
            turns = [_transition(turn, images) for turn in record["transitions"]]
            fields = {name: from_plain(record[name], images) for name in _FIELDS if name in record}
            episode = cls(**fields, transitions=turns)
            episode.return_range = return_range_of(episode.return_range)
            for name, types in _TYPES.items():
                if not isinstance(getattr(episode, name), types):
                    raise TypeError(f"{name} is {getattr(episode, name)!r:.100}")
        except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            raise EpisodeFileError(f"the record of an episode is damaged ({type(error).__name__}: {error})") from error
        return episode

    def __eq__(self, other: object) -> bool:
        """Compare all but durations (``info["episode"]["t"]``), the run that it belongs to, and who acted."""
        return same_record(self.to_dict(), other.to_dict()) if isinstance(other, Episode) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # records are mutable


_TYPES = {"id": str, "info": dict, "observation": str | list, "kwargs": dict, "first_reward": int | float}
"""Of the fields that reading an episode needs."""

_FIELDS = tuple(name for name in Episode.__dataclass_fields__ if name != "transitions")


def _transition(record: Mapping[str, Any], images: ImageFolder | None) -> Transition:
    action = {name: from_plain(value, images) for name, value in record["action"].items()}
    return Transition(
        observation=from_plain(record["observation"], images),
        action=Response(action.pop("text"), **action),
        reward=float(record["reward"]),
        terminated=bool(record["terminated"]),
        truncated=bool(record["truncated"]),
        info=from_plain(record["info"], images),
    )


def return_range_of(declared: Any) -> tuple[float, float] | None:
    """Return the range of returns that an environment or a record declares.

    Raises:
        ArgumentError: It is no pair of finite numbers, the lower one first.
    """
    if declared is None:
        return None
    try:
        low, high = map(float, declared)
    except (TypeError, ValueError):
        low = high = math.nan
    if not -math.inf < low < high < math.inf:
        raise ArgumentError(f"return_range must be (lowest, highest), two numbers, not {declared!r:.100}")
    return low, high


def same_record(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Tell whether two plain records are the same but for durations, their run, and who acted alone."""

    def compared(part: Any) -> Any:
        if isinstance(part, list):
            return list(map(compared, part))
        if not isinstance(part, dict):
            return part
        is_statistics = part.keys() == {"r", "l", "t"}
        return {name: compared(value) for name, value in part.items() if name != "t" or not is_statistics}

    known = {"run_seed": None, "agent": None}
    return bool(compared({**first, **known}) == compared({**second, **known}))
