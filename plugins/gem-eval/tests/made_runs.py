"""Runs of any size, made up: tasks with verdicts and without, epochs, cut-offs, errors, tokens and costs."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gem_core import Episode, Response, Transition
from gem_eval.records import RunWriter

INFO: dict[str, Any] = {
    "schema_version": 1,
    "status": "finished",
    "command": "gem eval mine.yaml --model openai:small --epochs 4",
    "suite": {"name": "mine", "tasks": [{"id": "mine:a"}], "epochs": 4},
    "models": [{"name": "openai:small", "agent": "openai:small", "options": {"temperature": 1.0}, "base_url": None}],
    "tasks": [{"id": "mine:a", "env": "mine:a", "kwargs": {}, "rows": 20, "data_sha256": "0f1e2d3c4b5a69788796a5b4"}],
    "epochs": 4,
    "seed": 7,
    "versions": {"python": "3.11.2", "aiohttp": "3.14.5", "gem-core": "0.1.0", "gem-games": "0.1.0"},
    "host": {"system": "Linux", "cpus": 2},
    "sessions": [{"started": 1_764_000_000.0, "ended": 1_764_000_812.0}],
}


def make_run(
    path: Path,
    tasks: Sequence[str] = ("mine:a",),
    models: Sequence[str] = ("openai:small",),
    *,
    rows: int = 20,
    epochs: int = 1,
    seed: int = 0,
    skill: float = 0.5,
    failing: float = 0.05,
    tells: bool = True,
    info: dict[str, Any] | None = None,
) -> Path:
    """Write a run and return its folder.

    Args:
        path: The folder.
        tasks: Names of the tasks; each row is harder or easier than others, for all models alike.
        models: Names of the models, each better than the one before.
        rows: Rows of each task.
        epochs: Epochs of each row.
        seed: Of what is chance.
        skill: Mean share of success of the first model.
        failing: Share of episodes with an error.
        tells: Whether the tasks say if they were solved.
        info: What ``run.json`` says.
    """
    chance = random.Random(seed)
    key = 0
    with RunWriter(path) as writer:
        writer.write_info(INFO if info is None else info)
        for task in tasks:
            for row in range(rows):
                ease = random.Random(f"{task}/{row}").gauss(0, 0.3)
                for place, model in enumerate(models):
                    for epoch in range(epochs):
                        share = min(max(skill + ease + 0.12 * place, 0.02), 0.98)
                        episode = made_episode(chance, task, share, failing=failing, tells=tells)
                        episode.seed, episode.key, episode.repeat, episode.agent = row, str(key), epoch, model
                        seconds = 2.0 + 3 * chance.random()
                        told = {"id": task, "model": model, "row": f"{task}/{row}", "seconds": seconds}
                        tokens = sum(
                            (turn.action.usage or {}).get("completion_tokens", 0) for turn in episode.transitions
                        )
                        told |= {"cost": 2e-6 * (1 + 4 * place) * tokens, "finished": 1_764_000_100.0 + key}
                        writer.write(episode, told)
                        key += 1
    return path


def made_episode(
    chance: random.Random, task: str, share: float, *, failing: float = 0.0, tells: bool = True
) -> Episode:
    """One episode, solved with a probability."""
    turns = []
    wanted = chance.randint(1, 6)
    for number in range(wanted):
        usage = {"prompt_tokens": 100 + 40 * number, "completion_tokens": chance.randint(20, 80)}
        said = Response(f"I try {number}.", usage=usage, finish_reason="stop", model="small-2026")
        turns.append(Transition(f"Turn {number}: go on.", said, 0.1 * chance.random(), False, False, {}))
    last = turns[-1]
    if chance.random() < failing:
        last.truncated, last.info = True, {"error": {"kind": "request", "cause": "rate_limit", "message": "429: slow"}}
    elif wanted == 6 and chance.random() < 0.6:
        last.truncated, last.info = True, {"cut_off": chance.choice(["turns", "time", "token budget"])}
    else:
        solved = chance.random() < share
        last.terminated, last.reward = True, float(solved)
        last.info = {"correct": solved, "parsed_action": None if not solved and wanted == 1 else last.action.text}
        if not tells:
            last.info, last.reward = {}, 10 * chance.gauss(share, 0.2)
    return Episode(task, 0, "Find the number.", {}, turns, "It is over.")
