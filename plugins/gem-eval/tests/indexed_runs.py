"""Runs that were never played: an index with the values that a test needs, and no episodes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gem_eval.records import Row


def write_index(path: Path, rows: Iterable[dict[str, Any]], **info: Any) -> Path:
    """Write a run; each row says what differs from an episode of the task ``t:A`` that failed."""
    path.mkdir(parents=True)
    (path / "run.json").write_text(json.dumps(info))
    lines = []
    for number, own in enumerate(rows, start=1):
        task, epoch = own.get("id", "t:A"), own.get("epoch", 0)
        known: dict[str, Any] = {
            "number": number, "offset": 0, "length": 1, "id": task, "model": "toy", "row": f"{task}/{number}",
            "epoch": epoch, "key": own.get("row", str(number)), "seed": 1, "success": False, "episode_return": 0.0,
            "turns": 1,
        }  # fmt: skip
        known |= own
        lines.append(json.dumps(Row(**{**known, "key": f"{known['key']}/{known['model']}"}).to_dict()))
    (path / "index.jsonl").write_text("\n".join(lines) + "\n")
    return path


def verdicts(solved: str, **own: Any) -> list[dict[str, Any]]:
    """Return rows for a text with a letter for each episode: 1 solved, 0 not, e an error, u unscored, c cut off."""
    told: dict[str, dict[str, Any]] = {
        "1": {"success": True, "episode_return": 1.0},
        "0": {},
        "e": {"success": None, "error": "server: gone"},
        "u": {"success": None},
        "c": {"cut_off": "turns"},
    }
    return [{"row": f"{own.get('id', 't:A')}/{place}", **told[letter], **own} for place, letter in enumerate(solved)]
