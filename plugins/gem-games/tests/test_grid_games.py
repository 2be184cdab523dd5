"""What Minesweeper, FifteenPuzzle, Sudoku, Game2048 and Sokoban all promise, for each of their ids."""

from __future__ import annotations

import json
import re
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.testing import check_env
from gem_games.fifteen_puzzle import FifteenPuzzleEnv
from gem_games.game import read_direction, sizes_to_draw
from gem_games.game_2048 import Game2048Env
from gem_games.minesweeper import MinesweeperEnv
from gem_games.sokoban import SokobanEnv
from gem_games.sudoku import SudokuEnv

# The parameters and turn limits of gem-llm; clues of Sudoku are given ones here, and dim_room has one name.
PARAMETERS: dict[str, dict[str, Any]] = {
    "game:Minesweeper-v0-easy": {"rows": 5, "cols": 5, "num_mines": 5, "max_turns": 25},
    "game:Minesweeper-v0-hard": {"rows": 8, "cols": 8, "num_mines": 12, "max_turns": 64},
    "game:Minesweeper-v0-random": {"rows": None, "cols": None, "num_mines": None, "max_turns": None},
    "game:FifteenPuzzle-v0-easy": {"num_rows": 2, "max_turns": 10},
    "game:FifteenPuzzle-v0-hard": {"num_rows": 4, "max_turns": 50},
    "game:FifteenPuzzle-v0-random": {"num_rows": None, "max_turns": None},
    "game:Sudoku-v0-easy": {"clues": 7, "max_turns": 15, "scale": 4},
    "game:Sudoku-v0-hard": {"clues": 34, "max_turns": 50, "scale": 9},
    "game:Sudoku-v0-random": {"clues": None, "max_turns": None, "scale": None},
    "game:Game2048-v0-easy": {"target_tile": 64, "max_turns": 50},
    "game:Game2048-v0-hard": {"target_tile": 512, "max_turns": 50},
    "game:Game2048-v0-extreme-hard": {"target_tile": 2048, "max_turns": 100},
    "game:Game2048-v0-random": {"target_tile": None, "max_turns": None},
    "game:Sokoban-v0-easy": {"dim_room": (6, 6), "num_boxes": 2, "max_turns": 20},
    "game:Sokoban-v0-hard": {"dim_room": (8, 8), "num_boxes": 4, "max_turns": 50},
    "game:Sokoban-v0-random": {"dim_room": None, "num_boxes": None, "max_turns": None},
}
IDS = list(PARAMETERS)
HOSTILE = [
    "",
    "\\boxed{}",
    "\\boxed{\x00}",
    "\\boxed{\ud800}",
    "\\boxed{" * 5_000,
    "\\boxed{\\boxed{1}}",
    "\\boxed{reveal \u0661 \u0662}",
    f"\\boxed{{reveal {'7' * 5_000} 1}}",
    f"\\boxed{{reveal{' ' * 5_000_000}1 1}}",
    f"\\boxed{{{'a' * 5_000_000} 1 1}}",
    f"\\boxed{{{'1 ' * 2_500_000}}}",
    f"\\boxed{{up{' ' * 5_000_000}up}}",
    "\\boxed{" + "UP" * 2_500_000 + "}",
]
BAD_ARGUMENTS = [
    (
        MinesweeperEnv,
        {"rows": 4, "cols": 4, "num_mines": 8},
        "a board of 4 by 4 has room for 1 to 7 mines beside the first reveal, not 8; change rows, cols or num_mines",
    ),
    (MinesweeperEnv, {"rows": 31}, "rows must be a whole number from 1 to 30, or None to draw it, not 31"),
    (FifteenPuzzleEnv, {"num_rows": 1}, "num_rows must be a whole number from 2 to 10, or None to draw it, not 1"),
    (SudokuEnv, {"scale": 16}, "scale must be 4 or 9, or None to draw it, not 16"),
    (SudokuEnv, {"clues": 30}, "clues must be a whole number from 31 to 80, or None to draw it, not 30"),
    (
        SudokuEnv,
        {"clues": 31, "max_turns": 49},
        "scale=9, clues=31 and max_turns=49 leave more cells empty than there are turns; raise clues or max_turns",
    ),
    (Game2048Env, {"target_tile": 100}, "target_tile must be a power of two, not 100"),
    (
        Game2048Env,
        {"target_tile": 32, "board_size": 2},
        "target_tile must be a whole number from 8 to 16, or None to draw it, not 32",
    ),
    (
        SokobanEnv,
        {"dim_room": (5, 5), "num_boxes": 3},
        "a room of 5 by 5 has place for 2 boxes, not 3; make it larger",
    ),
    (
        SokobanEnv,
        {"dim_room": 6},
        "dim_room must be two whole numbers from 5 to 20, rows and columns, or None to draw it, not 6",
    ),
]


def played(env: Any, seed: int) -> list[Any]:
    """Play an episode by random actions and return all that it gave."""
    records: list[Any] = [env.reset(seed=seed)]
    while len(records) == 1 or not records[-1][2]:
        records.append(env.step(env.sample_random_action()))
    return records


def test_registered_ids_and_parameters() -> None:
    """Every id has the parameters that published baselines were measured with."""
    assert {env_id: dict(gem.spec(env_id).kwargs) for env_id in IDS} == PARAMETERS


@pytest.mark.parametrize("env_id", IDS)
def test_keeps_the_contract(env_id: str) -> None:
    check_env(env_id)


@pytest.mark.parametrize("env_id", IDS)
def test_random_episodes(env_id: str) -> None:
    """No sampled action is lost; observations are feedback and suffix; infos are plain JSON; rewards add up to 1."""
    env = gem.make(env_id)
    for seed in range(30):
        records = played(env, seed)
        for number, record in enumerate(records):
            observation, info = record[0], record[-1]
            assert observation == info["feedback"] + info["suffix"]
            assert info == json.loads(json.dumps(info))
            assert f"Turns left: {env.unwrapped.max_turns - number}." in info["suffix"] or record[2]
            if number:
                assert info["parsed_action"] is not None
                assert "The turn is lost." not in observation
                assert type(record[1]) is float
                assert ("correct" in info) is record[2]
        assert sum(record[1] for record in records[1:]) <= 1 + 1e-9


@pytest.mark.parametrize("env_id", IDS)
def test_same_seed_same_episode(env_id: str) -> None:
    """Alone, after other episodes, and beside another instance."""
    env, other = gem.make(env_id), gem.make(env_id)
    first = [played(env, seed) for seed in range(8)]
    assert [played(other, seed) for seed in reversed(range(8))] == first[::-1]
    assert len({json.dumps(records) for records in first}) == 8


@pytest.mark.parametrize("env_id", IDS)
def test_state_goes_through_json_into_another_instance(env_id: str) -> None:
    """At every turn; the drawn parameters come along, and the drawing is the same."""
    env, sibling = gem.make(env_id, render_mode="ansi"), gem.make(env_id, render_mode="ansi")
    for seed in range(3):
        env.reset(seed=seed)
        over = False
        while not over:
            state = env.get_state()
            assert state == json.loads(json.dumps(state))
            sibling.reset(seed=seed + 1)
            sibling.set_state(json.loads(json.dumps(state)))
            assert sibling.render() == env.render()
            action = env.sample_random_action()
            assert sibling.sample_random_action() == action
            result = env.step(action)
            assert sibling.step(action) == result
            assert sibling.get_state() == env.get_state()
            over = result[2]


@pytest.mark.parametrize("env_id", IDS)
def test_state_before_the_first_reset(env_id: str) -> None:
    env, other = gem.make(env_id), gem.make(env_id)
    other.reset(seed=1)
    other.set_state(env.get_state())
    assert other.get_state() == env.get_state()


@pytest.mark.parametrize("env_id", IDS)
def test_hostile_responses_are_answered_fast_and_briefly(env_id: str) -> None:
    """A format error, ending the game or not; never more than a few seconds, nor a long answer."""
    for format_error_ends in (True, False):
        env = gem.make(env_id, format_error_ends=format_error_ends)
        for response in HOSTILE:
            env.reset(seed=0)
            started = time.perf_counter()
            observation, reward, terminated, truncated, _ = env.step(response)
            assert time.perf_counter() - started < 5, response[:40]
            assert len(observation) < 1_000
            assert observation.encode()
            assert (reward, terminated, truncated) in ((0.0, False, False), (-0.1, format_error_ends, False))


@pytest.mark.parametrize("env_id", IDS)
def test_sampling_before_the_beginning_and_after_the_end(env_id: str) -> None:
    env = gem.make(env_id)
    with pytest.raises(ResetNeededError, match="call reset"):
        env.sample_random_action()
    played(env, 0)
    assert re.fullmatch(r"\\boxed\{.+\}", env.sample_random_action())


@pytest.mark.parametrize("env_id", IDS)
def test_render_draws_only_when_asked_to(env_id: str) -> None:
    env = gem.make(env_id, render_mode="ansi")
    assert env.render() == "The game has not begun."
    env.reset(seed=0)
    env.step(env.sample_random_action())
    assert re.search(r"^turn 1 of \d+ · ", re.sub(r"\x1b\[\d+m", "", str(env.render())), re.MULTILINE)
    plain = gem.make(env_id)
    plain.reset(seed=0)
    assert plain.render() is None


@pytest.mark.parametrize(("env_type", "arguments", "message"), BAD_ARGUMENTS)
def test_bad_arguments_say_what_is_allowed(env_type: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        env_type(**arguments)
    assert str(caught.value) == message


def test_given_parameters_stay_while_others_are_drawn() -> None:
    """What was given replaces its part of each size; what cannot be solved then is left out."""
    assert sizes_to_draw(((1, 2), (3, 2), (3, 4)), (None, 5)) == [(1, 5), (3, 5)]
    field, tiles = MinesweeperEnv(None, None, 3, None), FifteenPuzzleEnv(None, 3)
    grid, room = SudokuEnv(None, 20, None), SokobanEnv((7, 9), None, None)
    for seed in range(20):
        for env in (field, tiles, grid, room):
            env.reset(seed=seed)
        assert (field.num_mines, field.max_turns) == (3, field.rows * field.cols)
        assert (tiles.num_rows, tiles.max_turns) in ((3, 10), (3, 20), (3, 50))
        assert (grid.scale, grid.max_turns) == (4, 20)
        assert (room.dim_room, room.num_boxes, room.max_turns) in (((7, 9), 2, 20), ((7, 9), 5, 50))


@pytest.mark.parametrize("env_id", [env_id for env_id in IDS if env_id.endswith("-random")])
def test_every_size_turns_up(env_id: str) -> None:
    env = gem.make(env_id).unwrapped
    sizes = set()
    for seed in range(60):
        env.reset(seed=seed)
        sizes.add(env.max_turns)
    expected = {
        "Minesweeper": {25, 36, 49, 64},
        "FifteenPuzzle": {10, 20, 50},
        "Sudoku": {15, 50},
        "Game2048": {20, 30, 50},
        "Sokoban": {20, 50},
    }
    assert sizes == expected[env_id.removeprefix("game:").partition("-")[0]]


@given(st.text(max_size=6) | st.sampled_from(["UP", "Down", "lefT", "right", " up"]))
def test_directions_are_read_in_any_case(text: str) -> None:
    read = read_direction(text)
    assert read == (text.lower() if text.lower() in ("up", "down", "left", "right") else None)


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(IDS),
    st.integers(0, 100),
    st.lists(st.sampled_from(["up", "Left", "reveal 0 0", "flag 1 1", "reveal 1 1", "1 1 1", "2 3 4"]), max_size=30),
)
def test_rewards_stay_within_bounds(env_id: str, seed: int, answers: list[str]) -> None:
    """Whatever is said, a game pays from -0.1 to 1 a turn and at most 1 in all."""
    env = gem.make(env_id, format_error_ends=False)
    env.reset(seed=seed)
    total = 0.0
    for answer in answers:
        _, reward, terminated, truncated, _ = env.step(f"\\boxed{{{answer}}}")
        assert not truncated
        assert -0.1 <= reward <= 1
        total += reward
        if terminated:
            break
    assert total <= 1 + 1e-9
