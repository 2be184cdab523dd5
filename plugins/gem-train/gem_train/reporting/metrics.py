"""Metrics of a run, a line an update: ``metrics.jsonl``, and if asked TensorBoard."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gem_core.errors import MissingRequirementError

METRICS_FILE = "metrics.jsonl"


class MetricsLog:
    """Writes the metrics of a run.

    A name that begins with ``eval/`` is of an evaluation: ``eval/return``, or with the evaluation's own name in between
    as in ``eval/Sudoku/return``. Plots show it as points in the panel of ``return``.

    Args:
        folder: The folder of the run, made where it is missing. ``metrics.jsonl`` in it is continued.
        tensorboard: Whether to write for TensorBoard as well, into ``folder/tensorboard``.

    Raises:
        MissingRequirementError: The package that writes for TensorBoard is not installed.
    """

    def __init__(self, folder: str | Path, tensorboard: bool = False) -> None:
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._board_folder = folder / "tensorboard"
        self._board = _open_tensorboard(self._board_folder) if tensorboard else None
        self._path = folder / METRICS_FILE
        cut_half_line(self._path)
        self._file = self._path.open("a", encoding="utf-8")

    def write(self, update: int, metrics: Mapping[str, float]) -> None:
        """Append the metrics of an update, and flush.

        Args:
            update: The number of the update; it never decreases.
            metrics: Numbers by name. Those that are not finite are written as null to ``metrics.jsonl``.
        """
        values = {name: float(value) for name, value in metrics.items()}
        finite = {name: value if math.isfinite(value) else None for name, value in values.items()}
        self._file.write(json.dumps({"update": update, **finite}) + "\n")
        self._file.flush()
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(name, value, update)
            self._board.flush()

    def truncate_after(self, update: int) -> None:
        """Remove what was written for later updates, to resume from a checkpoint of this one.

        TensorBoard no longer shows the later updates.
        """
        self._file.close()
        kept = [line for line in read_jsonl(self._path) if line["update"] <= update]
        self._path.write_text("".join(json.dumps(line) + "\n" for line in kept), encoding="utf-8")
        self._file = self._path.open("a", encoding="utf-8")
        if self._board is not None:
            self._board.close()
            self._board = _open_tensorboard(self._board_folder, purge_step=update + 1)

    def close(self) -> None:
        """Close the file, and what was opened beside it."""
        self._file.close()
        if self._board is not None:
            self._board.close()


def read_metrics(folder: str | Path) -> list[dict[str, float | None]]:
    """Return the lines of ``metrics.jsonl``: ``update`` and the metrics by name, None for one that was not finite.

    A half-written last line is left out. Without the file the list is empty.
    """
    return read_jsonl(Path(folder) / METRICS_FILE)


def read_jsonl(path: Path) -> list[dict[str, Any]]:
    """Return the objects in a file of JSON lines; a last line without its end is left out, as is a missing file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="\n") as lines:
        return [json.loads(line) for line in lines if line.endswith("\n")]


def cut_half_line(path: Path) -> None:
    """Remove a last line whose end is missing: its process was killed while it wrote."""
    if path.exists():
        with path.open("r+b") as file:
            file.truncate(file.read().rfind(b"\n") + 1)


def _open_tensorboard(folder: Path, purge_step: int | None = None) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise MissingRequirementError("TensorBoard is not installed: pip install 'gem-train[tensorboard]'") from error
    return SummaryWriter(str(folder), purge_step=purge_step)
