"""Minesweeper: the first reveal is safe, every field can be cleared, and what reveals and flags give."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem
from gem_games.minesweeper import MinesweeperEnv

Cells = frozenset[tuple[int, int]]


def box(answer: object) -> str:
    return f"I choose \\boxed{{{answer}}}."


def field(*mines: int, rows: int = 3, cols: int = 4, **kwargs: Any) -> MinesweeperEnv:
    """Return a game whose mines are known."""
    env = MinesweeperEnv(rows, cols, len(mines), **kwargs)
    env.reset(seed=0)
    env._set_mines(frozenset(mines))
    return env


def shown(observation: str) -> dict[tuple[int, int], str]:
    """Read the board of an observation."""
    rows = re.findall(r"^ {1,2}\d+((?:  [.F*0-8])+)$", observation, re.MULTILINE)
    return {(row, column): mark for row, marks in enumerate(rows) for column, mark in enumerate(marks.split())}


def known(board: dict[tuple[int, int], str]) -> tuple[Cells, Cells]:
    """Return the hidden cells that the numbers show to be safe, and those that they show to be mines.

    Each number says how many mines its hidden neighbours have; where one such set lies in another, so does the rest.
    """
    facts: set[tuple[Cells, int]] = set()
    for (row, column), mark in board.items():
        if mark.isdigit():
            around = [(r, c) for r in range(row - 1, row + 2) for c in range(column - 1, column + 2)]
            facts.add((frozenset(cell for cell in around if board.get(cell) == "."), int(mark)))
    facts.discard((frozenset(), 0))
    while True:
        safe = frozenset(cell for cells, count in facts if not count for cell in cells)
        mines = frozenset(cell for cells, count in facts if len(cells) == count for cell in cells)
        if safe:
            return safe, mines
        new = {(b - a, n - m) for a, m in facts for b, n in facts if a < b} - facts
        if not new:
            return safe, mines
        facts |= new


@pytest.mark.parametrize("variant", ["easy", "hard", "random"])
def test_many_fields_are_cleared_without_a_flag(variant: str, many: int) -> None:
    """By one who sees the mines: within the turns, for rewards that add up to 1, wherever the first reveal is."""
    env = gem.make(f"game:Minesweeper-v0-{variant}")
    task: Any = env.unwrapped
    for seed in range(many):
        env.reset(seed=seed)
        first = seed % (task.rows * task.cols)
        result = env.step(box(f"reveal {first // task.cols} {first % task.cols}"))
        total = result[1]
        assert total > 0
        assert len(task.mines) == task.num_mines
        for cell in set(range(task.rows * task.cols)) - task.mines:
            if task.shown[cell] == ".":
                result = env.step(box(f"reveal {cell // task.cols} {cell % task.cols}"))
                total += result[1]
        assert (result[2], result[4]["correct"]) == (True, True)
        assert total == pytest.approx(1.0)


def test_first_reveal_opens_an_area() -> None:
    """No mine is in its cell or around it, in any corner and for any seed."""
    env = MinesweeperEnv(5, 5, 16, 25)
    for seed in range(200):
        env.reset(seed=seed)
        row, column = divmod(seed % 25, 5)
        _, _, terminated, _, info = env.step(box(f"reveal {row} {column}"))
        assert shown(info["suffix"])[row, column] == "0"
        assert not terminated or info["correct"]


@pytest.mark.parametrize("variant", ["easy", "hard"])
def test_reasoning_never_meets_a_mine(variant: str) -> None:
    """Numbers tell the truth: a solver that reads them alone loses only where it must guess."""
    env = gem.make(f"game:Minesweeper-v0-{variant}")
    won = 0
    for seed in range(250):
        env.reset(seed=seed)
        observation, _, over, _, info = env.step(box("reveal 2 2"))
        while not over:
            safe, _ = known(shown(observation))
            if not safe:
                break
            for row, column in safe:
                if not over and shown(observation)[row, column] == ".":
                    observation, reward, over, _, info = env.step(box(f"reveal {row} {column}"))
                    assert reward > 0
        won += bool(over and info["correct"])
    assert won >= 40


def test_mines_depend_on_the_seed_and_vary() -> None:
    env = MinesweeperEnv(5, 5, 5, 25)
    fields = set()
    for seed in range(100):
        env.reset(seed=seed)
        env.step(box("reveal 0 0"))
        fields.add(env.mines)
    assert len(fields) > 95
    assert frozenset[int]().union(*filter(None, fields)) == set(range(25)) - {0, 1, 5, 6}


def test_reveal_counts_the_mines_around() -> None:
    env = field(0, 2)
    _, reward, terminated, truncated, info = env.step(box("reveal 0 1"))
    assert (reward, terminated, truncated) == (0.1, False, False)
    assert (info["feedback"], info["parsed_action"]) == ("You revealed 1 cell.", "reveal 0 1")
    assert info["suffix"] == (
        "\nThe board with 2 mines (. hidden, F flag, * mine), rows and columns numbered from 0:\n"
        "     0  1  2  3\n  0  .  2  .  .\n  1  .  .  .  .\n  2  .  .  .  .\n"
        "Turns left: 19. Answer like \\boxed{reveal 0 1} or \\boxed{flag 0 1}: row 0, column 1."
    )


def test_reveal_without_mines_around_goes_on() -> None:
    """To the cells around it, and from those without mines around on; cells with flags are left."""
    env = field(0)
    env.step(box("flag 0 3"))
    _, reward, terminated, _, info = env.step(box("Reveal  2 3"))
    assert (reward, terminated, info["feedback"]) == (pytest.approx(10 / 11), False, "You revealed 10 cells.")
    assert env.shown == ".10F" + "1100" + "0000"


def test_all_safe_cells_win_without_flags() -> None:
    """Unlike in gem-llm, which waits for a flag on every mine."""
    _, reward, terminated, truncated, info = field(0).step(box("reveal 2 3"))
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert info["feedback"] == "You revealed 11 cells. No cell without a mine is left: well done."


def test_a_safe_cell_with_a_flag_is_still_to_be_revealed() -> None:
    env = field(0)
    env.step(box("flag 0 3"))
    env.step(box("reveal 2 3"))
    env.step(box("flag 0 3"))
    _, reward, terminated, _, info = env.step(box("reveal 0 3"))
    assert (reward, terminated, info["correct"]) == (pytest.approx(1 / 11), True, True)


def test_a_mine_loses_and_shows_all() -> None:
    env = field(0, 5)
    _, reward, terminated, truncated, info = env.step(box("reveal 1 1"))
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert (info["feedback"], env.shown) == ("You revealed a mine.", "*....*......")


def test_a_flag_comes_and_goes() -> None:
    env = field(0)
    _, reward, _, _, info = env.step(box("FLAG 0 0"))
    assert (reward, info["feedback"], info["parsed_action"]) == (0.0, "You put a flag there.", "flag 0 0")
    assert env.shown[0] == "F"
    assert env.step(box("flag 0 0"))[4]["feedback"] == "You took the flag away."
    assert env.shown[0] == "."


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("reveal 0 1", "That cell is revealed already."),
        ("flag 0 1", "That cell is revealed already."),
        ("reveal 0 0", "That cell has a flag."),
        ("reveal 3 0", "There is no row 3 with a column 0 on the board."),
        ("flag 0 4", "There is no row 0 with a column 4 on the board."),
        ("reveal -1 0", "There is no row -1 with a column 0 on the board."),
        ("reveal 0 " + "9" * 500, "There is no row 0 with a column 9999999999 on the board."),
        ("open 0 2", "You can reveal or flag a cell, not 'open' it."),
    ],
)
def test_what_cannot_be_done_changes_nothing(answer: str, feedback: str) -> None:
    """Also to reveal a mine that has a flag, which loses in gem-llm."""
    env = field(0)
    env.step(box("flag 0 0"))
    env.step(box("reveal 0 1"))
    before = env.shown
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert (info["feedback"], env.shown) == (f"{feedback} The turn is lost.", before)


@pytest.mark.parametrize(("answer", "reward"), [("reveal 0 1", 1 / 11), ("flag 0 0", 0.0), ("x", -0.1)])
def test_last_turn_is_rewarded_like_any_other(answer: str, reward: float) -> None:
    _, got, terminated, truncated, info = field(0, max_turns=1).step(box(answer))
    assert got == pytest.approx(reward)
    assert (terminated, truncated, info["correct"]) == (True, False, False)


@pytest.mark.parametrize(
    "answer", ["", "reveal", "reveal 1", "1 1", "reveal 1 1 1", "reveal a b", "reveal 1,1", "reveal \u0661 1", "\ud800"]
)
def test_anything_else_ends_the_game(answer: str) -> None:
    _, reward, terminated, _, info = field(0).step(box(answer))
    assert (reward, terminated, info["correct"], info["parsed_action"]) == (-0.1, True, False, None)


def test_random_actions_are_left_when_all_hidden_cells_have_flags() -> None:
    """A flag is then taken away."""
    env = field(0, rows=1, cols=4)
    for column in range(4):
        env.step(box(f"flag 0 {column}"))
    assert re.fullmatch(r"\\boxed\{flag 0 [0-3]\}", env.sample_random_action())


def test_drawing() -> None:
    env = field(0, rows=1, cols=4)
    env.render_mode = "ansi"
    env.step(box("reveal 0 1"))
    env.step(box("flag 0 0"))
    drawing = "\x1b[2m    0 1 2 3\x1b[0m\n 0 \x1b[33m F\x1b[0m\x1b[34m 1\x1b[0m\x1b[1m ■\x1b[0m\x1b[1m ■\x1b[0m\n"
    assert str(env.render()).startswith(drawing)
