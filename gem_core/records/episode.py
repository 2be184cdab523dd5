"""Records of what happened: transitions, episodes, and the files that hold them.

A file has one JSON object on each line. Images are side files in a folder beside it, named by the hash of what they
show.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sized
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Self, cast

from gem_core.errors import EpisodeFileError
from gem_core.records.plain_json import ImageFolder, from_plain, to_plain
from gem_core.records.redaction import without_secrets
from gem_core.types import Info, Observation, Response

SCHEMA_VERSION = 1

_LONG_ARGUMENT = 2000


class EpisodeFileWarning(UserWarning):
    """A line of a file of episodes was passed over; the message says which and why."""


@dataclass
class Transition:
    """One turn.

    Args:
        observation: What the environment had returned; ``Episode.sent`` returns what the agent was sent of it.
        action: The response, to the letter.
        reward: Reward of this turn.
        terminated: Whether the task was over with it.
        truncated: Whether the episode was cut off after it.
        info: What ``step`` returned.
    """

    observation: Observation
    action: Response
    reward: float
    terminated: bool
    truncated: bool
    info: Info


@dataclass(eq=False)
class Episode:
    """All of one episode, and what it started from: enough to replay it.

    Args:
        id: Id of the environment, or the name of its class.
        seed: Seed of the episode.
        observation: The first observation.
        info: What ``reset`` returned.
        transitions: The turns in order; none where the reset failed.
        final_observation: What the last step returned.
        kwargs: Keyword arguments of the environment over the registered ones. In a file, those that are long, as the
            rows of a data set, are left out, and secrets blotted out.
        wrappers: Names and options of its wrappers, innermost first. In a file, secrets are blotted out.
        tools: Names of its tools.
        options: What was passed to ``reset``.
        group: Shared by episodes that started alike.
        key: The item's place in the plan.
        repeat: Which of the item's episodes it is, from 0.
        reads: What the agent was sent: ``"messages"``, ``"observation"`` or ``"concat_with_action"``; see ``sent``.
            None where that is not known, as in files of earlier versions.
        system: System text of the agent's own, which goes before that of the task.
        native_tools: Whether the agent was offered the tools beside what it was sent, which then explains them no more.
        run_seed: Seed of the run.
        versions: Version of each distribution that took part.
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
    schema_version: int = SCHEMA_VERSION

    @property
    def final_info(self) -> Info:
        """The info of the last step, or of the reset where there was none."""
        return self.transitions[-1].info if self.transitions else self.info

    @property
    def turns(self) -> int:
        """Number of turns."""
        return len(self.transitions)

    @property
    def episode_return(self) -> float:
        """Sum of the rewards, undiscounted."""
        return sum(transition.reward for transition in self.transitions)

    @property
    def messages(self) -> list[dict[str, Any]]:
        """The conversation as chat messages, whatever the agent was sent: system text first, tool results under ids."""
        from gem_core.records.conversation import (
            Conversation,  # imports Gymnasium, which a reader of files may do without
        )

        return Conversation(self).messages()

    def sent(self, turn: int) -> Observation:
        """Return what the agent was sent to answer in a turn, from 0: messages, or an observation.

        What a model was sent with an observation, its ``system`` text and the tools, is not in it.

        Raises:
            IndexError: There is no such turn.
        """
        from gem_core.records.conversation import Conversation

        asked = self.transitions[turn].observation
        before = self.transitions[: range(self.turns)[turn]]
        return Conversation(replace(self, transitions=before, final_observation=asked)).sent()

    @property
    def success(self) -> bool | None:
        """Whether the task was solved, as ``info["correct"]`` says at the end.

        False for an episode that was cut off without a word. None, for unknown, after an error, where the task ended
        and did not say, and where ``reset`` already said ``info["correct"] = None``: this task never tells.
        """
        correct = self.final_info.get("correct")
        if self.error is not None:
            return None
        if correct is not None:
            return bool(correct)
        ended = bool(self.transitions) and self.transitions[-1].terminated
        return None if ended or self.info.get("correct", False) is None else False

    @property
    def cut_off(self) -> Literal["turns", "tokens"] | None:
        """What cut the episode off; None for one that ended by itself or in an error.

        ``"tokens"``: its context overflowed, or its last response stopped at the model's token limit, whatever the task
        made of that. ``"turns"``: a limit of turns, or any other reason of the environment's.
        """
        if self.error is not None:
            return None
        last = self.transitions[-1] if self.transitions else None
        ended = last is not None and last.terminated
        if (last is not None and last.action.cut_off) or (not ended and self.final_info.get("context_overflow")):
            return "tokens"
        return None if ended else "turns"

    @property
    def error(self) -> dict[str, Any] | None:
        """What failed in the machinery, whatever the agent did; None for an episode that counts."""
        error = self.final_info.get("error")
        return error if error is None or isinstance(error, dict) else {"kind": "unknown", "message": str(error)}

    def to_dict(self, images: ImageFolder | None = None) -> dict[str, Any]:
        """Return the episode as plain JSON.

        Args:
            images: Where images are written; None leaves their content out.
        """
        fields = {name: value for name, value in vars(self).items() if name != "transitions"}
        # By their number first: to write a data set out only to find it long would take its time for every episode.
        fields["kwargs"] = {name: value for name, value in self.kwargs.items() if not _has_many_parts(value)}
        record = {name: to_plain(value, images) for name, value in fields.items()}
        kept = {name: value for name, value in record["kwargs"].items() if len(str(value)) <= _LONG_ARGUMENT}
        # Files are handed on: to whoever trains on them, or looks at them.
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
        except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
            raise EpisodeFileError(f"the record of an episode is damaged ({type(error).__name__}: {error})") from error
        episode._check()
        return episode

    def _check(self) -> None:
        for name, types in (("id", str), ("info", dict), ("observation", (str, list)), ("kwargs", dict)):
            if not isinstance(getattr(self, name), cast("type", types)):
                raise EpisodeFileError(f"the record of an episode is damaged: {name} is {getattr(self, name)!r:.100}")

    def __eq__(self, other: object) -> bool:
        """Compare all but durations (``info["episode"]["t"]``) and the run that it belongs to."""
        if not isinstance(other, Episode):
            return NotImplemented
        first, second = ({**_without_durations(each.to_dict()), "run_seed": None} for each in (self, other))
        return bool(first == second)

    __hash__ = None  # type: ignore[assignment]  # records are mutable


_FIELDS = tuple(name for name in Episode.__dataclass_fields__ if name != "transitions")


class EpisodeWriter:
    """Writes episodes to a file as they finish, each line at once.

    Args:
        path: The file; folders above it are made.
        append: Go on behind what is there, instead of writing the file anew with the first episode.

    Raises:
        EpisodeFileError: The file cannot be written.
    """

    def __init__(self, path: str | Path, *, append: bool = False) -> None:
        self.path = Path(path)
        self.count = 0
        self._images = ImageFolder.beside(self.path)
        self._append = append
        self._to_empty = not append
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            torn = append and _is_torn(self.path)
            # Without a buffer: a line is one system call, which Ctrl-C cannot cut in two.
            self._file = self.path.open("ab", buffering=0)
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error
        if torn:
            self._write(b"\n")

    def write(self, episode: Episode) -> None:
        """Write one episode."""
        # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
        try:
            record = episode.to_dict(self._images)
        except OSError as error:
            raise EpisodeFileError(f"cannot write the images of {self.path}: {error.strerror or error}") from error
        line = json.dumps(record, ensure_ascii=True, allow_nan=False)
        self._write(line.encode("ascii") + b"\n")
        self.count += 1

    def _write(self, data: bytes) -> None:
        try:
            self._empty()
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error

    def _empty(self) -> None:
        if self._to_empty and os.fstat(self._file.fileno()).st_size:
            self._file.truncate(0)
        self._to_empty = False

    def discard(self) -> None:
        """Close the file of a run that wrote nothing: what was there before stays, and an empty file goes."""
        self._to_empty = False
        self.close()
        with suppress(OSError):
            if not self._append and self.path.is_file() and not self.path.stat().st_size:
                self.path.unlink()

    def close(self) -> None:
        """Close the file; calling it again does nothing."""
        if not self._file.closed:
            self._empty()
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def write_episodes(path: str | Path, episodes: Iterable[Episode], *, append: bool = False) -> int:
    """Write episodes to a file and return their number; see ``EpisodeWriter``."""
    with EpisodeWriter(path, append=append) as writer:
        for episode in episodes:
            writer.write(episode)
        return writer.count


def read_episodes(path: str | Path, *, images: bool = True) -> Iterator[Episode]:
    """Yield the whole episodes of a file, one at a time.

    A line that is cut off or damaged is passed over, with an ``EpisodeFileWarning`` that names it.

    Args:
        path: The file.
        images: Read the images; without, the record of an image file stands in the place of each.

    Raises:
        EpisodeFileError: The file cannot be read.
    """
    path = Path(path)
    for line in episode_lines(path, images=images):
        if line.episode is not None:
            yield line.episode
        else:
            cut = "" if line.text.endswith(b"\n") else " The line is cut off: the writer was interrupted."
            warnings.warn(
                f"{path}, line {line.number}: passed over, because {line.damage}.{cut}",
                EpisodeFileWarning,
                stacklevel=2,
            )


class EpisodeLine(NamedTuple):
    """One line of a file of episodes.

    Args:
        number: From 1.
        text: As it stands there.
        episode: What it holds; None where it is damaged.
        damage: What is wrong with it.
    """

    number: int
    text: bytes
    episode: Episode | None
    damage: EpisodeFileError | None = None


def episode_lines(path: str | Path, *, images: bool = False) -> Iterator[EpisodeLine]:
    """Yield the lines of a file of episodes that are not blank; see ``read_episodes``.

    Raises:
        EpisodeFileError: The file cannot be read.
    """
    path = Path(path)
    folder = ImageFolder.beside(path) if images else None
    try:
        with path.open("rb") as file:
            for number, text in enumerate(file, start=1):
                if text.strip():
                    yield _line(number, text, folder)
    except OSError as error:
        raise EpisodeFileError(f"cannot read {path}: {error.strerror or error}") from error


def _line(number: int, text: bytes, images: ImageFolder | None) -> EpisodeLine:
    try:
        return EpisodeLine(number, text, Episode.from_dict(_parsed(text), images))
    except EpisodeFileError as error:
        return EpisodeLine(number, text, None, error)


def _parsed(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise EpisodeFileError(f"it is no valid JSON ({error})") from error


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


def _has_many_parts(value: object) -> bool:
    return isinstance(value, Sized) and len(value) > _LONG_ARGUMENT


def _is_torn(path: Path) -> bool:
    if not path.exists() or path.stat().st_size == 0:
        return False
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) != b"\n"


def _without_durations(record: Any) -> Any:
    if isinstance(record, dict):
        return {
            key: {name: part for name, part in value.items() if name != "t"}
            if key == "episode" and isinstance(value, dict)
            else _without_durations(value)
            for key, value in record.items()
        }
    if isinstance(record, list):
        return [_without_durations(value) for value in record]
    return record
