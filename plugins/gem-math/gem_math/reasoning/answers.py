"""Answers that are well-formed, for the tasks whose rows bring none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from random import Random


def example(task: str, entry: dict[str, Any], draws: Random) -> str:
    """Return an answer in the form that a scorer reads, rarely right.

    Args:
        task: Name of the task.
        entry: The row.
        draws: What it is drawn from.
    """
    metadata = entry["metadata"]
    if task == "boxnet":
        return json.dumps([_moved_box(metadata["initial_state"], draws)])
    if task == "graph_color":
        puzzle = metadata["puzzle"]
        return json.dumps({str(vertex): draws.choice(puzzle["color_options"]) for vertex in puzzle["vertices"]})
    if task == "propositional_logic":
        return str(draws.choice(metadata["variables"]))
    if task == "rubiks_cube":
        return " ".join(draws.choice("FRUBLD") + draws.choice(["", "'"]) for _ in range(4))
    if task == "rush_hour":
        cars = sorted(set(metadata["board_config"]) - set("ox."))
        return " ".join(f"{draws.choice(cars or ['A'])}{draws.choice('+-')}1" for _ in range(2))
    return ""


def _moved_box(state: dict[str, list[str]], draws: Random) -> dict[str, str]:
    """Return the move of a box into a neighbouring cell."""
    moves = []
    for cell, items in state.items():
        row, column = (float(number) for number in cell.split("_"))
        for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            beside = row + down, column + right
            if f"{beside[0]}_{beside[1]}" in state:
                moves += [(row, column, item, beside) for item in items if item.startswith("box_")]
    if not moves:
        return {}
    row, column, box, beside = draws.choice(moves)
    return {f"Agent[{row}, {column}]": f"move({box}, square[{beside[0]}, {beside[1]}])"}
