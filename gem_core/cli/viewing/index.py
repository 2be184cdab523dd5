"""Where each episode of a file stands, and what a list says of it, without reading the whole file each time.

The index of a large file is kept beside it (``run.jsonl.index``) and believed only while the file is what it was: of
the same size and time of change, or longer with the old part at its place. It is a cache: delete it at will.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records.episode import Episode

FORM = 2
"""Version of the form of an index; another one is rebuilt."""

INDEX_FROM_BYTES = 8_000_000
"""Smaller files are read anew faster than anyone notices, and leave no index behind."""

_CHUNK_BYTES = 1 << 20
_PRINT_BYTES = 4096
_LONGEST_TEXT = 300


class Entry(NamedTuple):
    """What a list says of an episode.

    Args:
        number: The line where it stands, from 1: it stays when a line above is damaged or the file grows.
        offset: Where the line begins, in bytes.
        length: Length of the line in bytes, with its end.
        id: Id of the environment.
        success: Whether the task was solved; None where that is not known.
        episode_return: Sum of the rewards.
        turns: Number of turns.
        error: What failed in the machinery, as ``kind: message``.
        seed: Seed of the episode.
        group: Shared by episodes that started alike.
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
    damage: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return what a machine wants to know, as plain JSON."""
        record = self._asdict()
        del record["damage"], record["offset"], record["length"]
        record["return"] = record.pop("episode_return")
        return record


class EpisodeFile:
    """A file of episodes, read as little as possible. It is looked at as it is when it is opened, and may grow.

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
            self._file = self.path.open("rb")
            self._scan = self.path.open("rb", buffering=_CHUNK_BYTES)
            status = os.fstat(self._scan.fileno())
        except OSError as error:
            raise EpisodeFileError(f"cannot read {path}: {error.strerror or error}") from error
        self.size, self._mtime_ns, self._mode = status.st_size, status.st_mtime_ns, status.st_mode
        self._keeps_index = self.size >= index_from_bytes
        self._known: list[Entry] = []
        self._covered = self._lines = self._saved = 0
        self._tail: Entry | None = None
        self._ended = False
        if self._keeps_index:
            self._load()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Keep what is indexed, and close the file; calling it again does nothing."""
        if not self._scan.closed:
            self._save()
        self._scan.close()
        self._file.close()

    @property
    def share_indexed(self) -> float:
        """How much of the file is indexed, from 0 to 1."""
        return self._covered / self.size if self.size and not self._ended else 1.0

    @property
    def damaged(self) -> list[Entry]:
        """The lines indexed so far that hold no whole episode."""
        return [entry for entry in self._all() if entry.damage is not None]

    def entries(self) -> Iterator[Entry]:
        """Yield the whole episodes in order: at once those that are indexed, then the others as they are found."""
        place = 0
        while place < len(self._known) or not self._ended:
            if place == len(self._known):
                self._advance()
            else:
                entry = self._known[place]
                place += 1
                if entry.damage is None:
                    yield entry
        if self._tail is not None and self._tail.damage is None:
            yield self._tail

    def entry(self, number: int) -> Entry:
        """Return the entry of one line, without an index of those before it.

        Raises:
            ArgumentError: There is no such line.
        """
        place = bisect_left(self._known, number, key=lambda entry: entry.number)
        if place < len(self._known) and self._known[place].number == number:
            return self._known[place]
        start, lines = self._line_start(number)
        self._file.seek(start)
        line = self._file.readline(self.size - start) if start < self.size else b""
        if not line:
            raise ArgumentError(f"no episode {number} in {self.path}, which has {lines:,} lines. Run 'gem show FILE'")
        if not line.strip():
            raise ArgumentError(f"no episode {number} in {self.path}: that line is blank. Run 'gem show FILE'")
        return _entry(number, start, line)

    def line(self, entry: Entry) -> bytes:
        """Return the line of an entry."""
        self._file.seek(entry.offset)
        return self._file.read(entry.length)

    def read(self, entry: Entry) -> Episode:
        """Return the episode of an entry; images stay names of files.

        Raises:
            EpisodeFileError: The line holds no whole episode.
        """
        try:
            return Episode.from_dict(_record(self.line(entry)))
        except (EpisodeFileError, ArithmeticError) as error:
            raise EpisodeFileError(f"{self.path}, line {entry.number}: {error}") from error

    def _all(self) -> list[Entry]:
        return self._known if self._tail is None else [*self._known, self._tail]

    def _advance(self) -> None:
        """Index the next line."""
        if self._scan.tell() != self._covered:
            self._scan.seek(self._covered)
        line = self._scan.readline(self.size - self._covered) if self._covered < self.size else b""
        self._ended = not line.endswith(b"\n")
        entry = _entry(self._lines + 1, self._covered, line) if line.strip() else None
        if self._ended:
            # It may still be written to, so the index that is kept must not hold it.
            self._tail = entry
            return
        self._covered += len(line)
        self._lines += 1
        if entry is not None:
            self._known.append(entry)

    def _line_start(self, number: int) -> tuple[int, int]:
        """Return where a line begins, or the end of the file; and the number of lines up to there."""
        start, lines = (self._covered, self._lines) if number > self._lines else (0, 0)
        self._file.seek(start)
        while lines < number - 1 and start < self.size:
            chunk = self._file.read(min(_CHUNK_BYTES, self.size - start))
            count = chunk.count(b"\n")
            if not chunk or lines + count >= number - 1:
                place = 0
                while chunk and lines < number - 1:
                    place = chunk.index(b"\n", place) + 1
                    lines += 1
                return start + place, lines
            start, lines = start + len(chunk), lines + count
        if start and start == self.size:
            self._file.seek(start - 1)
            lines += self._file.read(1) != b"\n"
        return start, lines

    def _fingerprint(self, covered: int) -> str:
        head = min(_PRINT_BYTES, covered)
        digest = hashlib.sha256()
        for offset in (0, covered - head):
            self._file.seek(offset)
            digest.update(self._file.read(head))
        return digest.hexdigest()

    def _load(self) -> None:
        try:
            head, _, rows = self.index_path.read_bytes().partition(b"\n")
            header = json.loads(head)
            covered, lines = _whole(header["covered"]), _whole(header["lines"])
            if not self._is_fresh(header, covered) or header["rows"] != hashlib.sha256(rows).hexdigest():
                return
            entries = [_checked(row) for row in json.loads(b"[" + b",".join(rows.splitlines()) + b"]")]
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            return  # A missing, damaged or foreign index is made anew.
        place, number = 0, 0
        for entry in entries:
            if entry.offset < place or entry.number <= number:
                return
            place, number = entry.offset + entry.length, entry.number
        if place <= covered and number <= lines:
            self._known, self._covered, self._lines, self._saved = entries, covered, lines, covered

    def _is_fresh(self, header: dict[str, Any], covered: int) -> bool:
        same = header["size"] == self.size and header["mtime_ns"] == self._mtime_ns
        grown = _whole(header["size"]) < self.size
        return (
            header["form"] == FORM
            and (same or grown)
            and covered <= header["size"]
            and header["fingerprint"] == self._fingerprint(covered)
        )

    def _save(self) -> None:
        if not self._keeps_index or self._covered == self._saved:
            return
        rows = "".join(f"{json.dumps(entry)}\n" for entry in self._known).encode("ascii")
        header = {
            "form": FORM,
            "size": self.size,
            "mtime_ns": self._mtime_ns,
            "covered": self._covered,
            "lines": self._lines,
            "fingerprint": self._fingerprint(self._covered),
            "rows": hashlib.sha256(rows).hexdigest(),
        }
        partial = ""
        try:
            handle, partial = tempfile.mkstemp(prefix=".", suffix=".partial", dir=self.path.parent)
            with os.fdopen(handle, "wb") as file:
                file.write(json.dumps(header).encode("ascii") + b"\n" + rows)
            Path(partial).chmod(self._mode & 0o666)
            Path(partial).replace(self.index_path)
        except OSError:
            # The folder is not ours to write: the next call indexes anew.
            with contextlib.suppress(OSError):
                Path(partial).unlink()


def _record(line: bytes) -> Any:
    if line.lstrip()[:1] != b"{":
        raise EpisodeFileError("it is no JSON object")
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise EpisodeFileError(f"it is no valid JSON ({error})") from error


def _entry(number: int, offset: int, line: bytes) -> Entry:
    place = (number, offset, len(line))
    try:
        record = _record(line)
        turns = record["transitions"] if isinstance(record.get("transitions"), list) else None
        # Only what the list says is looked at: the texts of a record are most of it.
        last = [{**turn, "observation": "", "action": {"text": ""}} for turn in turns[-1:]] if turns else turns
        episode = Episode.from_dict({**record, "transitions": last})
        error = episode.error
        return Entry(
            *place,
            id=_clipped(episode.id),
            success=episode.success,
            episode_return=sum(_reward(turn) for turn in turns or ()),
            turns=len(turns or ()),
            error=None if error is None else _clipped(f"{error.get('kind')}: {error.get('message')}"),
            seed=episode.seed if isinstance(episode.seed, int | None) else _clipped(str(episode.seed)),
            group=None if episode.group is None else _clipped(str(episode.group)),
        )
    except EpisodeFileError as error:
        cut = "" if line.endswith(b"\n") else ". The line is cut off: the writer was interrupted, or is still at it"
        return Entry(*place, damage=f"{error}{cut}")
    except (TypeError, KeyError, ValueError, AttributeError, ArithmeticError) as error:
        return Entry(*place, damage=f"the record of an episode is damaged ({type(error).__name__}: {error})")


def _reward(turn: Any) -> float:
    """Return the reward of a turn, if the turn is whole."""
    for name in ("observation", "terminated", "truncated", "info"):
        turn[name]
    turn["action"]["text"]
    return float(turn["reward"])


def _clipped(text: str) -> str:
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 1] + "…"


def _checked(row: Any) -> Entry:
    entry = Entry(*row)
    for value in (entry.number, entry.offset, entry.length, entry.turns):
        _whole(value)
    texts = (entry.error, entry.group, entry.damage)
    if (
        not isinstance(entry.id, str)
        or not isinstance(entry.episode_return, (float, int))
        or entry.success not in (True, False, None)
        or not isinstance(entry.seed, (int, str, type(None)))
        or not all(text is None or isinstance(text, str) for text in texts)
    ):
        raise ValueError("no row of an index")
    return entry


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError("no whole number")
    return value
