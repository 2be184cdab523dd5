"""What is mended in TextArena: its searches and rooms, the order of arguments; and who is to blame for a failure."""

from __future__ import annotations

import importlib
import importlib.util
import random
import sys
from collections import deque
from types import ModuleType
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_games.cheap_random import CheapRandom
from gem_games.sokoban_levels import make_level
from gem_games.textarena import searches
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.library import load
from gem_games.textarena.rooms import generate_room

MOVES = {-1: "[left]", 1: "[right]"}


def as_shipped(name: str) -> ModuleType:
    """Return a module of TextArena as it is without our mending."""
    found = importlib.util.find_spec(name)
    spec = importlib.util.spec_from_file_location(f"{name}_as_shipped", found.origin)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def own_draws():
    """Put the global random state back behind a test that seeds it."""
    state = random.getstate()
    yield random.Random
    random.setstate(state)


def test_sudoku_deals_the_grids_that_it_did(own_draws) -> None:
    load("Sudoku-v0")
    theirs = as_shipped("textarena.envs.Sudoku.env").SudokuEnv(clues=40)
    ours = sys.modules["textarena.envs.Sudoku.env"].SudokuEnv(clues=40)
    assert ours._count_solutions.__func__ is searches.count_solutions
    for seed in range(20):
        random.setstate(own_draws(seed).getstate())
        expected = theirs._generate_board()
        random.setstate(own_draws(seed).getstate())
        assert ours._generate_board() == expected


def test_sudoku_counts_two_solutions_and_none() -> None:
    """An empty grid has more than one, a row with a number that fits nowhere has none."""
    solutions: list[Any] = []
    assert searches.count_solutions(None, [[0] * 9 for _ in range(9)], solutions) == 2
    grid = [[1, 2, 3, 4, 5, 6, 7, 8, 0], [0] * 8 + [9], *([0] * 9 for _ in range(7))]
    solutions = []
    assert searches.count_solutions(None, grid, solutions) == 0


@pytest.mark.thorough
def test_rush_hour_deals_the_boards_that_it_did(own_draws) -> None:
    """The faster search says of each board what theirs says."""
    load("RushHour-v0")
    theirs = as_shipped("textarena.envs.RushHour.env").RushHourEnv()
    verdicts = set()
    for seed in range(12):
        random.setstate(own_draws(seed).getstate())
        board = theirs._generate_random_puzzle()
        verdict = searches.is_solvable(None, board)
        assert verdict == theirs._is_solvable(board)
        verdicts.add(verdict)
    assert verdicts == {True, False}


def test_word_ladder_pairs_are_so_many_steps_apart() -> None:
    """In the order of a plain breadth-first search, from which the game draws."""
    words = ["cat", "cot", "cog", "dog", "dig", "fig", "bat", "big"]
    near = searches.neighbour_map(words)
    expected = []
    for start in words:
        steps = {start: 0}
        queue = deque([start])
        while queue:
            word = queue.popleft()
            if 2 <= steps[word] <= 4:
                expected.append((start, word))
            for other in near[word]:
                if other not in steps:
                    steps[other] = steps[word] + 1
                    queue.append(other)
    pairs = searches.word_pairs(None, near, 2, 4)
    assert [pairs[place][:2] for place in range(len(pairs))] == expected
    assert near["cat"] == ("bat", "cot")


@pytest.mark.parametrize(
    ("game", "rows", "boxes", "steps"), [("Sokoban-v0", 6, 3, 20), ("Sokoban-v0-medium", 8, 5, 27)]
)
def test_sokoban_can_be_won(game: str, rows: int, boxes: int, steps: int) -> None:
    """Our level is on TextArena's board, and its solution wins there, within the turns."""
    env = TextArenaEnv(game)
    names = {**MOVES, -rows: "[up]", rows: "[down]"}
    for seed in range(30):
        env.reset(seed=seed)
        solution = make_level(rows, rows, boxes, steps, CheapRandom(env.np_random_seed % 2**32)).solution
        results = [env.step(names[move]) for move in solution]
        assert [result[2] for result in results] == [False] * (len(solution) - 1) + [True]
        assert results[-1][1] == 1.0
        assert results[-1][4]["correct"] is True


def test_a_room_of_sokoban_is_whole() -> None:
    """Outer walls, one player, as many boxes as goals."""
    fixed, state, _ = generate_room(dim=(8, 8), num_steps=27, num_boxes=5, seed=4)
    assert fixed.shape == state.shape == (8, 8)
    assert not fixed[0].any()
    assert not fixed[:, -1].any()
    assert (fixed == 2).sum() == ((state == 3) | (state == 4)).sum() == 5
    assert (state == 5).sum() == 1


@pytest.mark.parametrize("game", ["Slitherlink-v0", "Countdown-v0", "Cryptarithm-v0", "ThreeCardMonte-v0"])
def test_an_invalid_move_gives_the_progress_made_and_says_why(game: str) -> None:
    """These four games mix up reward and reason; the second invalid move in a row ends the game."""
    env = TextArenaEnv(game)
    env.reset(seed=1)
    observation, reward, terminated, _, info = env.step("[nonsense]")
    assert (reward, terminated, info["invalid_move"]) == (0.0, False, True)
    assert "You attempted an invalid move. Reason: " in observation
    observation, reward, terminated, _, info = env.step("[nonsense]")
    assert terminated
    assert 0.0 <= reward < 1.0
    assert info["textarena"]["reason"].startswith("Invalid Move: ")
    assert not info["textarena"]["reason"][14:].replace(".", "").isdigit()


def test_the_agents_own_action_is_known_as_its_own() -> None:
    """Slitherlink mixes up who said what; the agent is not told what it said itself."""
    env = TextArenaEnv("Slitherlink-v0")
    env.reset(seed=1)
    assert env.step("[h 0 0]")[4]["feedback"] == ""


def test_of_a_long_action_the_end_is_read() -> None:
    env = TextArenaEnv("TicTacToe-v0", players=2)
    env.reset(seed=1)
    info = env.step("[7] or " + "hm " * 5_000 + "[4]")[4]
    assert info["invalid_move"] is False
    assert env.table.actions[0] == info["parsed_action"]
    assert len(info["parsed_action"]) == 4_000
    assert info["parsed_action"].endswith("hm [4]")


def failing(observation: str) -> str:
    raise ConnectionError("no answer")


def test_an_opponent_that_fails_truncates_with_an_error() -> None:
    """Any action would have failed, so it is nobody's loss."""
    env = TextArenaEnv("TicTacToe-v0", players=2, opponents=failing)
    env.reset(seed=1)
    _, reward, terminated, truncated, info = env.step("[4]")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] == "opponent"
    assert info["error"]["message"] == "the agent at 'player_1' failed: ConnectionError: no answer"
    assert "correct" not in info


def test_an_opponent_that_fails_at_reset_raises() -> None:
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=failing)
    with pytest.raises(EnvFaultError, match="the agent at 'player_0' failed: ConnectionError: no answer") as caught:
        env.reset(seed=1)
    assert isinstance(caught.value.__cause__, ConnectionError)


def test_a_vector_environment_counts_such_a_reset_as_failed() -> None:
    """It goes on, and the budget of faults ends it when nothing else comes."""
    with (
        pytest.raises(gem.errors.FaultBudgetError, match="the agent at 'player_0' failed: ConnectionError: no answer"),
        gem.make_vec("ta:TicTacToe-v0", 1, backend="sync", seat=1, opponents=failing) as vector,
    ):
        vector.reset()


def test_opponents_who_never_end_their_turn_at_reset_raise() -> None:
    """They make the same invalid move again and again, where that costs nothing."""
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: "[4]")
    env.table.act = lambda action: None
    with pytest.raises(EnvFaultError, match="the turn of 'player_1' did not come in 300 turns of the others"):
        env.reset(seed=1)


def test_opponents_who_end_each_game_before_the_agents_turn_fail_the_reset() -> None:
    """The opponent loses by two invalid moves; where it does so once, another game is dealt."""
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: "[nonsense]")
    with pytest.raises(EnvFaultError, match="10 games in a row were over before 'player_1' acted"):
        env.reset(seed=1)
    answers = iter(["[nonsense]", "[nonsense]", "[4]"])
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: next(answers))
    observation, _ = env.reset(seed=1)
    assert "Player 0 placed their symbol (O) in cell 4." in observation
    other = env.fork()
    assert other.table.actions == env.table.actions == ["[4]"]


def tic_tac_toe() -> Any:
    """Return TextArena's class of the game."""
    return type(load("TicTacToe-v0")[0])


def test_a_library_that_fails_on_any_action_truncates_with_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    env = TextArenaEnv("TicTacToe-v0", players=2)
    env.reset(seed=1)
    broken = tic_tac_toe()

    def step(self: Any, action: str) -> Any:
        raise KeyError("board")

    monkeypatch.setattr(broken, "step", step)
    _, reward, terminated, truncated, info = env.step("[4]")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"] == {"kind": "textarena", "message": "KeyError: 'board'"}


def test_a_library_that_fails_on_one_action_loses_the_game(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another action was to be had, so the agent is to blame."""
    env = TextArenaEnv("TicTacToe-v0", players=2)
    env.reset(seed=1)
    broken = tic_tac_toe()
    plain = broken.step

    def step(self: Any, action: str) -> Any:
        if "13" in action:
            raise OverflowError("too much")
        return plain(self, action)

    monkeypatch.setattr(broken, "step", step)
    _, reward, terminated, truncated, info = env.step("[13]")
    assert (reward, terminated, truncated, info["correct"]) == (-1.0, True, False, False)
    assert info["invalid_move"] is True
    assert info["feedback"] == "The game could not read your response (OverflowError), and is lost."


def test_a_library_that_fails_at_reset_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    """So a vector environment counts a failed reset."""
    env = TextArenaEnv("TicTacToe-v0", players=2)

    def reset(self: Any, num_players: int, seed: int) -> Any:
        raise KeyError("board")

    monkeypatch.setattr(tic_tac_toe(), "reset", reset)
    with pytest.raises(KeyError):
        env.reset(seed=1)
