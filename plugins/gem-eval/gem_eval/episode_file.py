"""``EpisodeFile``: an index of the episodes in a file, so that a list need not read the whole file each time.

The index of a large file is kept beside it (``run.jsonl.index``) and used only while the file is what it was: of the
same size and time of change, or longer with the old part unchanged. It is a cache and may be deleted.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Self

from gem_core import Episode, JointEpisode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import ImageFolder, Record, record_from_dict
from gem_eval.files import write_whole
from gem_eval.turns import error_text, some_success

FORM = 4
"""Version of the form of an index; an index of another form is built anew."""

INDEX_FROM_BYTES = 8_000_000
"""Smaller files are read in less than 0.1 s, and get no index beside them."""

_CHUNK_BYTES = 1 << 20
_FINGERPRINT_BYTES = 4096
_LONGEST_TEXT = 300


class SeatEntry(NamedTuple):
    """What a list says of one seat of an episode of several agents.

    Args:
        agent: Name of the agent that sat there.
        success: Whether it solved its task, or won; None where that is not known.
        episode_return: Sum of its rewards.
        turns: Number of its turns.
        error: What failed for it, as ``kind: message``.
    """

    agent: str
    success: bool | None
    episode_return: float
    turns: int
    error: str | None


class Entry(NamedTuple):
    """The row of an episode in a list.

    Args:
        number: The line where it stands, from 1: it stays when a line above is damaged or the file grows.
        offset: Where the line begins, in bytes.
        length: Length of the line in bytes, with its end.
        id: Id of the environment.
        success: Whether the task was solved; None where that is not known. Of several agents, whether one of them did.
        episode_return: Sum of the rewards, of several agents those of all.
        turns: Number of turns, of several agents the steps in which one or more acted.
        error: What failed in the machinery, as ``kind: message``.
        seed: Seed of the episode.
        group: Shared by episodes that started alike.
        seats: Of several agents, what each of them did, by seat.
        damage: Why the line holds no whole episode; None where it does.
    """

    number: int
    offset: int
    length: int
    id: str = ""
    success: bool | None = None
    episode_return: float = 0.0
    turns: int = 0
    error: str | None = None
    seed: int | str | None = None
    group: str | None = None
    seats: dict[str, SeatEntry] | None = None
    damage: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain JSON, for programs."""
        record = self._asdict()
        del record["damage"], record["offset"], record["length"], record["seats"]
        record["return"] = record.pop("episode_return")
        if self.seats is not None:
            record["seats"] = {seat: own._asdict() for seat, own in self.seats.items()}
            for own in record["seats"].values():
                own["return"] = own.pop("episode_return")
        return record


class EpisodeFile:
    """A file of episodes, read as little as possible. Only what it holds when it is opened is indexed; it may grow.

    Args:
        path: The file.
        index_from_bytes: Size from which the index is kept in a file beside it, where the folder can be written.

    Raises:
        EpisodeFileError: The file cannot be read.
    """

    def __init__(self, path: str | Path, *, index_from_bytes: int = INDEX_FROM_BYTES) -> None:
        self.path = Path(path)
        self.index_path = self.path.with_name(self.path.name + ".index")
        try:
            if not self.path.is_file() and self.path.exists():
                raise EpisodeFileError(f"cannot read {path}: it is no regular file; write it to one first")
            self._file = self.path.open("rb", buffering=_CHUNK_BYTES)
            self._status = os.fstat(self._file.fileno())
        except OSError as error:
            raise EpisodeFileError(f"cannot read {path}: {error.strerror or error}") from error
        self.size = self._status.st_size
        self._keeps_index = self.size >= index_from_bytes
        self._entries: list[Entry] = []
        self._covered = self._lines = self._saved = 0
        self._ended = False
        if self._keeps_index:
            # A missing, damaged or foreign index is built anew.
            with suppress(OSError, ValueError, TypeError, KeyError):
                self._load()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Save the index, and close the file; calling it again does nothing."""
        if self._keeps_index and self._covered > self._saved:
            self._save()
        self._file.close()

    @property
    def images(self) -> ImageFolder:
        """Folder of the images."""
        return ImageFolder.beside(self.path)

    @property
    def share_indexed(self) -> float:
        """How much of the file is indexed, from 0 to 1."""
        return self._covered / self.size if self.size and not self._ended else 1.0

    @property
    def damaged(self) -> list[Entry]:
        """The lines indexed so far that hold no whole episode."""
        return [entry for entry in self._entries if entry.damage is not None]

    def entries(self) -> Iterator[Entry]:
        """Yield the whole episodes in order: at once those that are indexed, then the others as they are found."""
        place = 0
        while place < len(self._entries) or not self._ended:
            if place == len(self._entries):
                self._index_line()
                continue
            entry = self._entries[place]
            place += 1
            if entry.damage is None:
                yield entry

    def entry(self, number: int) -> Entry:
        """Return the entry of the episode in one line, without an index of the lines before it.

        Raises:
            ArgumentError: There is no such line, or it is blank.
            EpisodeFileError: The line holds no whole episode.
        """
        entry = next((entry for entry in self._entries if entry.number == number), None) or self._find(number)
        if entry.damage is not None:
            raise EpisodeFileError(f"{self.path}, line {number} holds no whole episode: {entry.damage}")
        return entry

    def line(self, entry: Entry) -> bytes:
        """Return the line of an entry."""
        return os.pread(self._file.fileno(), entry.length, entry.offset)

    def read(self, entry: Entry) -> Record:
        """Return the episode of an entry; images stay names of files.

        Raises:
            EpisodeFileError: The line holds no whole episode.
        """
        try:
            return record_from_dict(_record(self.line(entry)))
        except (EpisodeFileError, ArithmeticError) as error:
            raise EpisodeFileError(f"{self.path}, line {entry.number}: {error}") from error

    def _find(self, number: int) -> Entry:
        # In 100 MB this takes 0.03 s, and indexing the lines before 0.5 s.
        offset, lines = (self._covered, self._lines) if number > self._lines else (0, 0)
        self._file.seek(offset)
        reason = ""
        for line in self._file:
            lines += 1
            if lines == number:
                if line.strip():
                    return _entry(number, offset, line)
                reason = ": that line is blank"
                break
            offset += len(line)
        reason = reason or f", which has {lines:,} lines"
        raise ArgumentError(f"no episode {number} in {self.path}{reason}. Run 'gem show {self.path}'")

    def _index_line(self) -> None:
        self._file.seek(self._covered)
        line = self._file.readline(self.size - self._covered)
        if line.strip():
            self._entries.append(_entry(self._lines + 1, self._covered, line))
        if line.endswith(b"\n"):
            self._covered += len(line)
            self._lines += 1
        else:
            self._ended = True

    def _load(self) -> None:
        digest, _, body = self.index_path.read_bytes().partition(b"\n")
        if digest != _digest(body):
            return
        index = json.loads(body)
        size, covered = index["size"], index["covered"]
        same = (size, index["mtime_ns"]) == (self.size, self._status.st_mtime_ns)
        if index["form"] == FORM and (same or size < self.size) and index["ends"] == self._ends(covered):
            self._entries = [_entry_of_row(row) for row in index["rows"]]
            self._covered = self._saved = covered
            self._lines = index["lines"]

    def _save(self) -> None:
        index = {
            "form": FORM,
            "size": self.size,
            "mtime_ns": self._status.st_mtime_ns,
            "covered": self._covered,
            "lines": self._lines,
            "ends": self._ends(self._covered),
            # A last line without a line end may still be written to.
            "rows": [entry for entry in self._entries if entry.offset < self._covered],
        }
        body = json.dumps(index).encode("ascii")
        # Where the folder cannot be written, the next call indexes anew.
        with suppress(OSError):
            write_whole(self.index_path, _digest(body) + b"\n" + body, self._status.st_mode & 0o666)
        self._saved = self._covered

    def _ends(self, covered: int) -> str:
        """Return a digest of the first and the last bytes of the indexed part, which tells a rewritten file."""
        length = min(_FINGERPRINT_BYTES, covered)
        pieces = [os.pread(self._file.fileno(), length, offset) for offset in (0, covered - length)]
        return _digest(b"".join(pieces)).decode("ascii")


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode("ascii")


def _record(line: bytes) -> Any:
    if line.lstrip()[:1] != b"{":
        raise EpisodeFileError("it is no JSON object")
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise EpisodeFileError(f"it is no valid JSON ({error})") from error


def _entry_of_row(row: list[Any]) -> Entry:
    entry = Entry(*row)
    if entry.seats is None:
        return entry
    return entry._replace(seats={seat: SeatEntry(*own) for seat, own in entry.seats.items()})


def _entry(number: int, offset: int, line: bytes) -> Entry:
    place = (number, offset, len(line))
    try:
        record = _record(line)
        facts = _joint_facts(record) if "seats" in record else _facts(record)
        return Entry(*place, **facts)
    except EpisodeFileError as error:
        cut = "" if line.endswith(b"\n") else ". The line is cut off: the writer was interrupted, or is still at it"
        return Entry(*place, damage=f"{error}{cut}")
    except (TypeError, KeyError, ValueError, AttributeError, ArithmeticError) as error:
        return Entry(*place, damage=f"the record of an episode is damaged ({type(error).__name__}: {error})")


def _facts(record: dict[str, Any]) -> dict[str, Any]:
    episode = Episode.from_dict(_shortened(record))
    return {**_start(episode), **_figures(episode, record)}


def _joint_facts(record: dict[str, Any]) -> dict[str, Any]:
    records = record["seats"]
    joint = JointEpisode.from_dict({**record, "seats": {seat: _shortened(own) for seat, own in records.items()}})
    seats = {
        seat: SeatEntry(_clipped(str(episode.agent)), **_figures(episode, records[seat]))
        for seat, episode in joint.seats.items()
    }
    return {
        **_start(joint),
        "success": some_success(joint),
        "episode_return": sum(own.episode_return for own in seats.values()),
        "turns": joint.turns,
        "error": _error(joint),
        "seats": seats,
    }


def _shortened(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record of an episode with nothing of its turns but the last info.

    The list needs no more, but for the rewards; to read all turns would take four times as long.
    """
    turns = record["transitions"] if isinstance(record.get("transitions"), list) else None
    last = [{**turn, "observation": "", "action": {"text": ""}} for turn in turns[-1:]] if turns else turns
    return {**record, "final_observation": "", "transitions": last}


def _start(episode: Record) -> dict[str, Any]:
    return {
        "id": _clipped(episode.id),
        "seed": episode.seed if isinstance(episode.seed, int | None) else _clipped(str(episode.seed)),
        "group": None if episode.group is None else _clipped(str(episode.group)),
    }


def _figures(episode: Episode, record: dict[str, Any]) -> dict[str, Any]:
    turns = record["transitions"]
    return {
        "success": episode.success,
        "episode_return": sum((_reward(turn) for turn in turns), episode.first_reward),
        "turns": len(turns),
        "error": _error(episode),
    }


def _error(episode: Record) -> str | None:
    return None if episode.error is None else _clipped(error_text(episode.error))


def _reward(turn: Any) -> float:
    """Return the reward of a turn; raise where a part of the turn is missing."""
    for name in ("observation", "terminated", "truncated", "info"):
        turn[name]
    turn["action"]["text"]
    return float(turn["reward"])


def _clipped(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 1] + "…"
