"""Write the branches of an episode as a run of their own, the original before them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core import Episode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import ImageFolder, to_plain
from gem_eval.files import new_run_folder
from gem_eval.records import RunWriter

if TYPE_CHECKING:
    from gem_eval.replaying.replay import Replay


def write_branches(replay: Replay, agent: str, out: str | None) -> Path:
    """Write the original and the branches, each with what it was branched from, and return where.

    The original is episode 1, by the model ``original``; the branches follow, by the model of the agent's name. They
    share their row, so that ``gem compare`` and ``gem show --diff`` put them side by side.

    Args:
        replay: With branches.
        agent: Name of who went on.
        out: A folder that is not there yet, or the name of a file that ends in ``.jsonl``; None for a folder in
            ``runs/``.

    Raises:
        ArgumentError: It is there already.
        EpisodeFileError: It cannot be written.
    """
    path = new_run_folder("replay") if out is None else Path(out)
    if out is not None and path.exists():
        raise ArgumentError(f"{out} is there already; choose another name for --out")
    begun = {"run": str(replay.run.path), "episode": replay.row.number, "from_turn": replay.turns + 1}
    if path.suffix == ".jsonl":
        _write_file(path, replay, agent, begun)
        return path
    with RunWriter(path) as writer:
        writer.write_info({"command": "gem replay", "branched_from": begun, "agent": agent, "ended": time.time()})
        for episode, told in _episodes(replay, agent, begun):
            writer.write(episode, told)
    return path


def _episodes(replay: Replay, agent: str, begun: dict[str, Any]) -> Iterator[tuple[Episode, dict[str, Any]]]:
    told = {"id": replay.row.id, "row": replay.row.row}
    original = {**told, "model": "original", "original_model": replay.row.model, "copied_from": begun}
    yield replace(replay.original, key="original", repeat=0), original
    for episode in replay.episodes:
        yield episode, {**told, "model": agent, "branched_from": begun}


def _write_file(path: Path, replay: Replay, agent: str, begun: dict[str, Any]) -> None:
    images = ImageFolder.beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="ascii") as file:
            for episode, told in _episodes(replay, agent, begun):
                file.write(json.dumps({**episode.to_dict(images), "evaluation": to_plain(told)}) + "\n")
    except OSError as error:
        raise EpisodeFileError(f"cannot write {path}: {error.strerror or error}") from error
