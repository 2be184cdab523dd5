"""``Row``: what the index of a run says of one episode."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any

from gem_core import Episode
from gem_core.errors import EpisodeFileError
from gem_core.records import Record, record_from_dict, return_range_of, to_plain
from gem_eval.turns import episodes_of, error_text, some_success

_LONGEST_TEXT = 300


@dataclass(slots=True)
class Row:
    """What the index says of one episode.

    Args:
        number: From 1, in the order in which episodes were written; in a file of ``gem run``, the line.
        offset: Where the frame, or the line, begins in the file of episodes, in bytes.
        length: Its length in bytes.
        id: Name of the task in the suite, by default the id of the environment.
        model: Name of the agent that acted.
        row: Identity of what was asked, the same in every run: the task, and the row of its data set or the seed.
        epoch: Which time the row was played, from 0.
        key: Place in the plan.
        seed: Seed of the episode.
        success: Whether the task was solved; None where that is not known. Of several agents, whether one of them did.
        episode_return: Sum of the rewards, of several agents those of all.
        turns: Number of turns, of several agents the steps in which one or more acted.
        error: What failed in the machinery, as ``kind: message``; None for an episode that counts.
        cause: Kind of that error in a word, as ``"rate_limit"`` or ``"exception"``.
        cut_off: Why the episode was cut off; None for one that ended by itself.
        unreadable: Whether the last response held nothing that the task could read; of several agents, that of one.
        tokens_in: Tokens that the model read; None where its server does not say.
        tokens_out: Tokens that it wrote.
        cost: In US dollars; None without a price.
        seconds: From the first question to the end.
        model_seconds: Those in which the model was asked.
        finished: When the episode ended, in seconds since 1970.
        group: Shared by episodes that started alike.
        return_range: The lowest and the highest return that the environment declares; None where it declares none.
        seat: Name of the seat, for the row of one of several agents; ``id`` then names the seat as well.
        seats: Of several agents, the row of each of them, by seat; the index of a folder has none.
    """

    number: int
    offset: int
    length: int
    id: str
    model: str
    row: str
    epoch: int
    key: str
    seed: int | None
    success: bool | None
    episode_return: float
    turns: int
    error: str | None = None
    cause: str | None = None
    cut_off: str | None = None
    unreadable: bool = False
    tokens_in: int | None = None
    tokens_out: int | None = None
    cost: float | None = None
    seconds: float | None = None
    model_seconds: float | None = None
    finished: float | None = None
    group: str | None = None
    return_range: tuple[float, float] | None = None
    seat: str | None = None
    seats: dict[str, Row] | None = None

    def apart(self) -> list[Row]:
        """Return the rows of the seats, each as a row of its own; of an agent alone, the row itself."""
        own = self.seats or {}
        return [replace(each, id=f"{self.id} {seat}", seat=seat) for seat, each in own.items()] or [self]

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain JSON, without what is as it is by default."""
        record = {name: value for name in _ALLOWED if (value := getattr(self, name)) != _DEFAULTS.get(name, MISSING)}
        return {**record, "episode_return": to_plain(self.episode_return)}

    @classmethod
    def from_line(cls, line: bytes) -> Row:
        """Return the row that a line of the index holds; fields of later versions are left out.

        Raises:
            EpisodeFileError: It is no row.
        """
        try:
            record = json.loads(line)
            record["return_range"] = return_range_of(record.get("return_range"))
            return cls(**_sound({name: value for name, value in record.items() if name in _ALLOWED}))
        except (AttributeError, TypeError, ValueError, RecursionError) as error:
            raise EpisodeFileError(f"a line of the index is damaged ({error})") from error

    @classmethod
    def of(cls, record: Mapping[str, Any], number: int, offset: int, length: int) -> Row:
        """Return the row of an episode's record, as it stands in the file.

        Args:
            record: The record.
            number: See the class.
            offset: See the class.
            length: See the class.

        Raises:
            EpisodeFileError: It is no record of an episode.
        """
        episode = record_from_dict(record)
        told = record.get("evaluation")
        own = told if isinstance(told, Mapping) else {}
        try:
            row = cls.of_episode(episode, own, number, offset, length)
            return cls(**_sound({name: getattr(row, name) for name in _ALLOWED}), seats=row.seats)
        except (AttributeError, TypeError, ArithmeticError) as error:
            raise EpisodeFileError(f"the record of an episode is damaged ({type(error).__name__}: {error})") from error

    @classmethod
    def of_episode(cls, episode: Record, own: Mapping[str, Any], number: int, offset: int, length: int) -> Row:
        """Return the row of an episode, of one agent or of several.

        Args:
            episode: The episode.
            own: What its record says under ``"evaluation"``.
            number: See the class.
            offset: See the class.
            length: See the class.
        """
        parts, error = episodes_of(episode), episode.error
        if isinstance(episode, Episode):
            seats, agents, place = None, episode.agent or "", episode.info.get("task_id", episode.seed)
        else:
            seats = {seat: cls.of_episode(each, {}, number, offset, length) for seat, each in episode.seats.items()}
            agents, place = ", ".join(f"{seat}={agent}" for seat, agent in episode.agents.items()), episode.seed
        task = _name(own.get("id", episode.id))
        return cls(
            number=number,
            offset=offset,
            length=length,
            id=task,
            model=_name(own.get("model", agents)),
            row=_name(own.get("row", f"{task}/{place}")),
            epoch=episode.repeat,
            key=episode.key,
            seed=episode.seed,
            success=some_success(episode),
            episode_return=sum(part.episode_return for part in parts),
            turns=episode.turns,
            error=None if error is None else _clipped(error_text(error)),
            cause=None if error is None else _clipped(error.get("cause") or error.get("kind")),
            cut_off=next((part.cut_off for part in parts if part.cut_off), None),
            unreadable=any(part.unreadable for part in parts),
            tokens_in=_tokens(parts, "prompt_tokens"),
            tokens_out=_tokens(parts, "completion_tokens"),
            group=None if episode.group is None else _clipped(episode.group),
            return_range=episode.return_range if isinstance(episode, Episode) else None,
            seats=seats,
            **{name: own[name] for name in _MEASURED if name in own},
        )


_DEFAULTS = {each.name: each.default for each in fields(Row) if each.default is not MISSING}
_TYPES = {"int": (int,), "str": (str,), "bool": (bool,), "float": (float, int), "tuple[float, float]": (tuple,)}
_ALLOWED = {
    each.name: (*_TYPES[kind], *([type(None)] if optional else []))
    for each in fields(Row)
    for kind, optional, _ in [str(each.type).partition(" | None")]
    if each.name != "seats"
}
"""The types of each field of the index."""
_MEASURED = ("cost", "seconds", "model_seconds", "finished")
"""What only the record says, under ``"evaluation"``."""


def _tokens(episodes: Sequence[Episode], name: str) -> int | None:
    counts = [(turn.action.usage or {}).get(name) for episode in episodes for turn in episode.transitions]
    known = [count for count in counts if type(count) is int]
    return sum(known) if known else None


def _name(value: object) -> str:
    """Return a name; a long one is cut, and told apart from others that begin so by a digest."""
    text = str(value)
    if len(text) <= _LONGEST_TEXT:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    return f"{text[: _LONGEST_TEXT - 17]}…{digest}"


def _clipped(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 1] + "…"


def _sound(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a row, with numbers in the place of their names, as "Infinity".

    Raises:
        EpisodeFileError: A value is of another type than its field.
    """
    for name, value in values.items():
        if type(value) not in _ALLOWED[name]:
            if type(value) is not str or float not in _ALLOWED[name]:
                raise EpisodeFileError(f"a row is damaged: {name} is {value!r:.100}")
            values[name] = float(value)
    return values
