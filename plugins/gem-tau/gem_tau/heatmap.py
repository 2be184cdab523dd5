"""The heat map of the paper: how often each assistant succeeds with each user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gem_core import rollout
from gem_core.progress import Progress
from gem_core.records import EnvSummary
from gem_tau.env import ASSISTANT, USER


def heat_map(
    ids: Sequence[str],
    users: Sequence[str],
    assistants: Sequence[str],
    *,
    episodes: int | None = None,
    seed: int = 0,
    num_envs: int | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> list[list[EnvSummary]]:
    """Let each assistant serve each user, and count how often it succeeds.

    Args:
        ids: Environments, each with the seats ``assistant`` and ``user``.
        users: Names of agents, as ``tau-user:terse`` or ``openai:MODEL``; one row each.
        assistants: Names of agents; one column each.
        episodes: Episodes of each environment and cell; None for each task once.
        seed: Of the run; every cell plays the same episodes.
        num_envs: Episodes at once; None for as many as the agents may be asked at once.
        arguments: Keyword arguments of every environment, as ``folder``.

    Returns:
        The counts of the assistant's episodes: a row for each user, in it a summary for each assistant.
    """
    chosen = [(env_id, dict(arguments or {})) for env_id in ids]
    rows = []
    with Progress(len(users) * len(assistants), "cells", unit="cells") as progress:
        for user in users:
            rows.append([EnvSummary(user, seat=ASSISTANT, agent=name) for name in assistants])
            for column, cell in enumerate(rows[-1]):
                agents = {ASSISTANT: cell.agent, USER: user}
                run = rollout(chosen, agents=agents, episodes=episodes, seed=seed, num_envs=num_envs)
                for episode in run:
                    if ASSISTANT in episode.seats:
                        cell.add(episode.seats[ASSISTANT])
                    else:  # the reset failed, or the user before its first word
                        cell.errors += 1
                progress.advance((len(rows) - 1) * len(assistants) + column + 1)
    return rows


def plain_rows(rows: Sequence[Sequence[EnvSummary]]) -> list[dict[str, Any]]:
    """Return the cells as plain JSON, row by row."""
    return [
        {
            "user": cell.id,
            "assistant": cell.agent,
            "success_rate": cell.success_rate,
            "success_standard_error": cell.success_standard_error,
            "episodes": cell.judged,
            "errors": cell.errors,
            "mean_turns": cell.mean_turns,
        }
        for row in rows
        for cell in row
    ]


def percent(cell: EnvSummary) -> str:
    """Return the success rate of a cell and its standard error, in percent."""
    if cell.success_rate is None or cell.success_standard_error is None:
        return "-"
    return f"{100 * cell.success_rate:.1f} ± {100 * cell.success_standard_error:.1f}"
