"""``ScoreFile``: the scores of a run by one grader, one JSON line for each episode."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import to_plain, without_secrets
from gem_core.suggestions import did_you_mean

if TYPE_CHECKING:
    from gem_eval.records import Run

_NAME = re.compile(r"[\w.-]{1,100}", re.ASCII)


@dataclass(frozen=True)
class Grade:
    """What a grader said of an episode.

    Args:
        value: The score; a verdict is 0 or 1. None where the grader cannot tell, or failed.
        metrics: All that it returned, where it returned several.
        error: Why it failed; None where it did not.
        note: What it said besides, as the reason of a judge, or where a replay differs from the record.
    """

    value: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    error: str | None = None
    note: str | None = None


class ScoreFile:
    """The file of scores of one name, read when it is made, and appended to.

    It stands in ``scores/`` of the run's folder; of a file ``mine.jsonl``, in ``mine.scores/`` beside it.

    Args:
        run: The run.
        name: Name of the scores, which need not be there yet.

    ``grader`` is what graded, as the first line says it; None for a new file. ``graded`` holds the grades by the number
    of their episode, of several the last.

    Raises:
        ArgumentError: It cannot be the name of a file.
        EpisodeFileError: The file cannot be read.
    """

    def __init__(self, run: Run, name: str) -> None:
        if not _NAME.fullmatch(name) or name.startswith("."):
            raise ArgumentError(f"{name!r} is no name of scores: use letters, digits, '.', '-' and '_'; give --name")
        self.path = folder_of(run) / f"{name}.jsonl"
        self.grader: dict[str, Any] | None = None
        self.graded: dict[int, Grade] = {}
        self._file: BinaryIO | None = None
        self._whole = 0
        """Bytes of the file without a line that was torn."""
        try:
            self._read()
        except OSError as error:
            raise EpisodeFileError(f"cannot read {self.path}: {error.strerror or error}") from error

    def begin(self, grader: Mapping[str, Any], *, overwrite: bool = False) -> None:
        """Open the file to append; of a new one, write what grades to its first line.

        Args:
            grader: What grades, as plain JSON.
            overwrite: Begin anew.

        Raises:
            ArgumentError: Something else has graded under this name.
            EpisodeFileError: It cannot be written.
        """
        told = without_secrets(to_plain(dict(grader)))
        if overwrite:
            self.grader, self.graded, self._whole = None, {}, 0
        if self.grader not in (None, told):
            raise ArgumentError(
                f"{self.path} holds the scores of another grader, or of one with other settings or code; give --name "
                "for a file of its own, or --overwrite"
            )
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("ab", buffering=0)
            self._file.truncate(self._whole)
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error
        if self.grader is None:
            self._write({"grader": told})
        self.grader = told

    def add(self, episode: int, grade: Grade) -> None:
        """Append the grade of an episode.

        Raises:
            EpisodeFileError: It cannot be written.
        """
        self._write({"episode": episode, **asdict(grade)})
        self.graded[episode] = grade

    def close(self) -> None:
        """Close the file; what is added later is not written."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, record: Mapping[str, Any]) -> None:
        if self._file is not None:
            try:
                # One system call, which Ctrl-C cannot cut in two.
                self._file.write(json.dumps(to_plain(record), ensure_ascii=True).encode("ascii") + b"\n")
            except OSError as error:
                raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error

    def _read(self) -> None:
        if not self.path.exists():
            return
        for line in self.path.read_bytes().splitlines(keepends=True):
            if not line.endswith(b"\n"):
                return  # torn by a kill: it is cut off before the next is written
            self._whole += len(line)
            try:
                record = json.loads(line)
                if "grader" in record:
                    self.grader = record["grader"]
                else:
                    number = int(record.pop("episode"))
                    self.graded[number] = Grade(**record)
            except (ValueError, RecursionError, KeyError, TypeError) as error:
                raise EpisodeFileError(
                    f"cannot read {self.path}: a line is damaged ({error}); delete the file"
                ) from error


def values_of(run: Run, name: str) -> dict[int, float | None]:
    """Return the scores of a name, by the number of the episode; None where the grader could not tell.

    Raises:
        ArgumentError: There are none.
        EpisodeFileError: They cannot be read.
    """
    found = ScoreFile(run, name)
    if not found.graded:
        there = sorted(path.stem for path in folder_of(run).glob("*.jsonl"))
        listed = f" There are: {', '.join(there)}" if there else f" Run 'gem score {run.path} --grader …'"
        raise ArgumentError(f"{run.path} has no scores {name!r}.{did_you_mean(name, there)}{listed}")
    return {number: grade.value for number, grade in found.graded.items()}


def folder_of(run: Run) -> Path:
    """Return the folder of the scores of a run."""
    return run.path / "scores" if run.is_folder else run.path.with_suffix(".scores")
