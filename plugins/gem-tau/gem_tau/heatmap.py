"""The heat map of the paper: how often each assistant succeeds with each user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from gem_core import rollout
from gem_core.progress import Progress
from gem_core.records import EnvSummary
from gem_tau.env import ASSISTANT, USER

_TOP, _HEIGHT, _LETTER = 62, 56, 7.5  # pixels: what is above the cells, the height of one, the width of a letter
_NO, _YES = (196, 88, 38), (44, 108, 170)  # colours of 0 and of 1; halfway stands white


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


def svg(rows: Sequence[Sequence[EnvSummary]]) -> str:
    """Return the heat map as a picture: users from top to bottom, assistants from left to right."""
    left = 30 + round(_LETTER * max(len(row[0].id) for row in rows))
    cell_width = max(140, 20 + round(_LETTER * max(len(str(cell.agent)) for cell in rows[0])))
    width, height = left + cell_width * len(rows[0]) + 10, _TOP + _HEIGHT * len(rows) + 10
    title = "Success of the assistant in %, ± standard error"
    shapes = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        _text(left + cell_width * len(rows[0]) // 2, 22, title, size=13, weight="bold"),
    ]
    for column, cell in enumerate(rows[0]):
        shapes.append(_text(left + cell_width * column + cell_width // 2, _TOP - 14, str(cell.agent), size=12))
    for number, row in enumerate(rows):
        top = _TOP + _HEIGHT * number
        shapes.append(_text(left - 12, top + _HEIGHT // 2 + 4, row[0].id, size=12, anchor="end"))
        for column, cell in enumerate(row):
            shapes += _cell(left + cell_width * column, top, cell_width, cell)
    return "\n".join([*shapes, "</svg>\n"])


def percent(cell: EnvSummary) -> str:
    """Return the success rate of a cell and its standard error, in percent."""
    if cell.success_rate is None or cell.success_standard_error is None:
        return "-"
    return f"{100 * cell.success_rate:.1f} ± {100 * cell.success_standard_error:.1f}"


def _cell(left: int, top: int, width: int, cell: EnvSummary) -> list[str]:
    middle = left + width // 2
    return [
        f'<rect x="{left}" y="{top}" width="{width - 2}" height="{_HEIGHT - 2}" fill="{_colour(cell.success_rate)}"/>',
        _text(middle, top + 26, percent(cell), size=15, weight="bold"),
        _text(middle, top + 43, f"n = {cell.judged}", size=10),
    ]


def _colour(rate: float | None) -> str:
    if rate is None:
        return "#eeeeee"
    end, share = (_YES, 2 * rate - 1) if rate > 0.5 else (_NO, 1 - 2 * rate)
    red, green, blue = (round(255 + 0.75 * share * (each - 255)) for each in end)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _text(x: int, y: int, text: str, *, size: int, anchor: str = "middle", weight: str = "normal") -> str:
    style = f'font-size="{size}" text-anchor="{anchor}" font-weight="{weight}"'
    return f'<text x="{x}" y="{y}" {style}>{escape(text)}</text>'
