"""The episodes of runs as a file that ``gem run`` could have written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core.records import ImageFolder, record_from_dict, whole_file

if TYPE_CHECKING:
    from gem_eval.records import Row, Run


def write_jsonl(runs: Sequence[Run], path: Path) -> int:
    """Write the episodes of runs as JSON lines, their images beside them, and return their number.

    Each line is whole, without references to earlier observations. What a run says of an episode besides stays under
    ``"evaluation"``, so that ``open_run`` of the file finds the same rows. A damaged episode is left out, and noted in
    ``Run.damage``.

    Args:
        runs: The runs.
        path: The file.

    Raises:
        EpisodeFileError: A run cannot be read.
        OSError: The file cannot be written.
    """
    count = 0
    images = ImageFolder.beside(path)

    def record(run: Run, row: Row) -> dict[str, Any]:
        line = run.line(row)
        told = {"evaluation": line["evaluation"]} if "evaluation" in line else {}
        return record_from_dict(line, run.images).to_dict(images) | told

    with whole_file(path) as file:
        for run in runs:
            whole = {row.number: row for row in run.rows}  # of several agents, the seats share a line
            for _, each in run.intact(whole.values(), partial(record, run)):
                file.write(json.dumps(each, ensure_ascii=True, allow_nan=False).encode("ascii") + b"\n")
                count += 1
    return count
