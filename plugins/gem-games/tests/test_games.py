"""What every game for one promises, for each id under ``game:``; the rest stands in a file of its own for each game."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from game_solvers import SOLVERS, box, played
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import AgentError
from gem_core.testing import check_env
from gem_games.agents import BisectionAgent, HanoiAgent, MastermindAgent
from gem_games.fifteen_puzzle import FifteenPuzzleEnv
from gem_games.game import quote, read_direction, whole_number, whole_numbers
from gem_games.guess_the_number import GuessTheNumberEnv
from gem_games.mastermind import MastermindEnv
from gem_games.minesweeper import MinesweeperEnv
from gem_games.sokoban import SokobanEnv
from gem_games.sudoku import SudokuEnv

# The parameters and turn limits of gem-llm, our own id without a variant, and what each random id draws.
PARAMETERS: dict[str, tuple[str, list[tuple[Any, ...]]]] = {
    "GuessTheNumber-v0": ("min_number max_number max_turns", [(1, 50, 10), (1, 10, 4), (1, 50, 7)]),
    "Mastermind-v0": ("code_length num_numbers max_turns", [(2, 6, 10), (4, 8, 30)]),
    "TowerofHanoi-v0": ("num_disks max_turns", [(3, 10), (5, 35)]),
    "Wordle-v0": ("word_length only_real_words max_turns", [(3, True, 15), (5, True, 25)]),
    "Hangman-v0": ("word_length hardcore max_turns", [(3, False, 10), (7, False, 20)]),
    "Crosswords-v0": ("hardcore max_turns num_words", [(False, 30, 3), (True, 40, 3)]),
    "WordSearch-v0": ("hardcore max_turns num_words", [(False, 20, 5), (True, 20, 5)]),
    "Minesweeper-v0": ("rows cols num_mines max_turns", [(5, 5, 5, 25), (8, 8, 12, 64)]),
    "FifteenPuzzle-v0": ("num_rows max_turns", [(2, 10), (4, 50)]),
    "Sudoku-v0": ("clues max_turns scale", [(7, 15, 4), (34, 50, 9)]),
    "Game2048-v0": ("target_tile max_turns", [(64, 50), (512, 50), (2048, 100)]),
    "Sokoban-v0": ("dim_room num_boxes max_turns", [((6, 6), 2, 20), ((8, 8), 4, 50)]),
}
VARIANTS = {"GuessTheNumber-v0": ("", "-easy", "-hard"), "Game2048-v0": ("-easy", "-hard", "-extreme-hard")}
DRAWN = {
    "Mastermind": {(2, 4, 10), (4, 6, 20), (4, 8, 30)},
    "TowerofHanoi": {(3, 10), (4, 20), (5, 35)},
    "Wordle": {(3, True, 15), (4, True, 20), (5, True, 25)},
    "Hangman": {(3, False, 10), (5, False, 15), (7, False, 20)},
    "Crosswords": {(False, 20, 3), (True, 20, 3)},
    "WordSearch": {(False, 20, 5), (True, 20, 5)},
    "Minesweeper": {(5, 5, 5, 25), (6, 6, 7, 36), (7, 7, 9, 49), (8, 8, 12, 64)},
    "FifteenPuzzle": {(2, 10), (3, 20), (4, 50)},
    "Sudoku": {(7, 15, 4), (34, 50, 9)},
    "Game2048": {(16, 20), (32, 30), (64, 50)},
    "Sokoban": {((6, 6), 2, 20), ((8, 8), 5, 50)},
}
IDS = [env_id for env_id in gem.list_envs("game") if not gem.spec(env_id).seats]
RANDOM = [env_id for env_id in IDS if env_id.endswith("-random")]
SOLVED = [env_id for env_id in IDS if env_id[5:].partition("-")[0] in SOLVERS and "Wiki" not in env_id]
FORMAT_ERROR = {env_id: -0.2 if "WikiGame" in env_id else -0.1 for env_id in IDS}
NO_GOLD = ("Minesweeper", "FifteenPuzzle", "Game2048", "Sokoban")
LONGEST_FEEDBACK = 1_000  # characters
HOSTILE = ["", "\\boxed{}", "\\boxed{   }", "\\boxed{\x00}", "\\boxed{\x1b[2J}", "\\boxed{\ud800}", "\\boxed{" * 5_000]
HOSTILE += ["\\boxed{{{{1}}}}", "\\boxed{\\boxed{1}}", "\\boxed{\u0661}", "\\boxed{\uff11 \uff12}", "x" * 5_000_000]
HOSTILE += ["\\boxed{0 0 \u0130}", "\\boxed{reveal \u0661 \u0662}", f"\\boxed{{reveal {'7' * 5_000} 1}}"]
HOSTILE += [f"\\boxed{{reveal{' ' * 5_000_000}1 1}}", f"\\boxed{{{'a' * 5_000_000} 1 1}}", f"\\boxed{{{'7' * 5_000}}}"]
HOSTILE += [f"\\boxed{{-{'7' * 5_000}}}", f"\\boxed{{{'1 ' * 2_500_000}}}", f"\\boxed{{up{' ' * 5_000_000}up}}"]
HOSTILE += [
    f"\\boxed{{<LINKS{' ' * 1_000_000}2>}}",
    "\\boxed{<LINKS 999999999999999999>}",
    f"\\boxed{{{'x_' * 10**6}}}",
]
ANSWERS = st.text("ABCabc 0123\\boxed{},-", max_size=12) | st.sampled_from(
    ["up", "Left", "reveal 0 0", "flag 1 1", "reveal 1 1", "1 1 1", "2 3 4", "0 0 0 4", "1 2 3 4", "<PREV_PAGE>"]
)


def test_ids_have_the_parameters_of_published_baselines() -> None:
    """Every id of each game; a random one leaves all to be drawn that the others differ in."""
    for game, (names, values) in PARAMETERS.items():
        for variant, expected in zip(VARIANTS.get(game, ("-easy", "-hard")), values, strict=True):
            assert dict(gem.spec(f"game:{game}{variant}").kwargs) == dict(zip(names.split(), expected, strict=True))
        left = gem.spec(f"game:{game}-random").kwargs
        assert list(left) == names.split()
        assert set(left.values()) <= {None, True, False}


def test_the_guide_lists_the_registered_ids() -> None:
    """All but TextArena's, of which it tells how they are named."""
    from gem_games._plugin import gem_register_agents, gem_register_envs

    guide = Path(__file__).parents[3].joinpath("docs", "games.md").read_text(encoding="utf-8")
    table = [line.split("`")[1] for line in guide.splitlines() if line.startswith("| `")]
    games = [spec.id for spec in gem_register_envs() if spec.namespace == "game"]
    assert table == games + [spec.name for spec in gem_register_agents()]


def test_plugin_declares_without_importing_anything_heavy() -> None:
    """Listing the games loads neither the games nor what they stand on; lists of words are read length by length."""
    code = (
        "import sys, gem_games._plugin as plugin\n"
        "list(plugin.gem_register_envs()), list(plugin.gem_register_agents())\n"
        "heavy = {'gymnasium', 'numpy', 'pydantic', 'rich', 'textarena', 'gem_core.env.base', 'gem_games.words'}\n"
        "seen = sorted(heavy & set(sys.modules))\n"
        "from gem_games.words import word_list, words\n"
        "words(5), words(5)\n"
        "print(seen, word_list.cache_info().currsize)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] 1"


@pytest.mark.parametrize("env_id", [env_id for env_id in RANDOM if "Guess" not in env_id and "Wiki" not in env_id])
def test_every_size_turns_up(env_id: str) -> None:
    """And no other."""
    env: Any = gem.make(env_id).unwrapped
    name = env_id[5:].partition("-")[0]
    names = PARAMETERS[f"{name}-v0"][0].split()
    drawn = {(env.reset(seed=seed), tuple(getattr(env, each) for each in names))[1] for seed in range(100)}
    assert drawn == DRAWN[name]


def test_given_parameters_stay_while_others_are_drawn() -> None:
    """What was given replaces its part of each size; what cannot be solved then is left out."""
    env = GuessTheNumberEnv(min_number=100, max_number=None, max_turns=3)
    below = GuessTheNumberEnv(min_number=None, max_number=0, max_turns=3)
    codes = MastermindEnv(num_numbers=3, code_length=None, max_turns=None)
    field, tiles = MinesweeperEnv(None, None, 3, None), FifteenPuzzleEnv(None, 3)
    grid, room = SudokuEnv(None, 20, None), SokobanEnv((7, 9), None, None)
    for seed in range(30):
        for each in (env, below, codes, field, tiles, grid, room):
            each.reset(seed=seed)
        assert (env.min_number, env.max_turns, 105 <= env.max_number <= 150) == (100, 3, True)
        assert -50 <= below.min_number <= -5
        assert (codes.code_length, codes.num_numbers, codes.max_turns) == (2, 3, 10)
        assert (field.num_mines, field.max_turns) == (3, field.rows * field.cols)
        assert (tiles.num_rows, tiles.max_turns) in ((3, 10), (3, 20), (3, 50))
        assert (grid.scale, grid.max_turns) == (4, 20)
        assert (room.dim_room, room.num_boxes, room.max_turns) in (((7, 9), 2, 20), ((7, 9), 5, 50))


def test_guess_the_number_and_mastermind_draw_all_there_is() -> None:
    """The lowest number is 1 to 10, the highest 5 to 50 above it; codes are of different numbers, unless asked for."""
    env = GuessTheNumberEnv(None, None, None)
    drawn = []
    for seed in range(2_000):
        env.reset(seed=seed)
        span = env.max_number - env.min_number
        assert env.max_turns == -int(-(span**0.5) // 1) + 1
        drawn.append((env.min_number, span, (env.number - env.min_number) / span))
    lowest, spans, shares = zip(*drawn, strict=True)
    assert (set(lowest), set(spans)) == (set(range(1, 11)), set(range(5, 51)))
    assert (min(shares), max(shares)) == (0, 1)
    assert sum(shares) / len(shares) == pytest.approx(0.5, abs=0.03)
    for repeats, count in ((False, 6), (True, 9)):
        codes = MastermindEnv(2, 3, 5, duplicate_numbers=repeats)
        assert len({(codes.reset(seed=seed), tuple(codes.code))[1] for seed in range(200)}) == count


@pytest.mark.parametrize("env_id", SOLVED)
def test_solver_wins_many_games(env_id: str, many: int) -> None:
    """Every instance is solvable within its turns, from the latest observation alone; the rewards add up to 1."""
    env, agent = gem.make(env_id), SOLVERS[env_id[5:].partition("-")[0]]()
    for seed in range(many):
        records = played(env, seed, agent)
        assert records[-1][4]["correct"], f"seed {seed}: {records[-1][0]}"
        assert sum(record[1] for record in records[1:]) == pytest.approx(1.0)


def test_solvers_read_histories_and_content_parts_and_refuse_other_games() -> None:
    for name in ("GuessTheNumber-v0", "Mastermind-v0-easy", "TowerofHanoi-v0-easy"):
        env = gem.make(f"game:{name}", wrappers="concat_with_action")
        assert all(played(env, seed, SOLVERS[name.partition("-")[0]]())[-1][4]["correct"] for seed in range(5))
    guess, _ = gem.make("game:GuessTheNumber-v0").reset(seed=0)
    assert BisectionAgent()([{"type": "text", "text": guess}]) == "\\boxed{25}"
    assert BisectionAgent()([{"role": "user", "content": guess}]) == "\\boxed{25}"
    towers, _ = gem.make("game:TowerofHanoi-v0-easy").reset(seed=0)
    for agent, observation in ((BisectionAgent(), towers), (MastermindAgent(), towers), (HanoiAgent(), guess)):
        with pytest.raises(AgentError):
            agent(observation)
    with pytest.raises(AgentError, match="100,000 codes"):
        MastermindAgent()(MastermindEnv(8, 20).reset(seed=0)[0])


EXHAUSTED = {
    "Mastermind-v0-easy": {"code_length": 2, "num_numbers": 3, "max_turns": 6},
    "Hangman-v0-easy": {"max_turns": 10_000},
    "Crosswords-v0-easy": {"max_turns": 10_000, "num_words": 1},
    "Wordle-v0-easy": {"max_turns": 10_000},
    "WordSearch-v0-easy": {"max_turns": 10_000, "num_words": 1},
}


@pytest.mark.parametrize("name", EXHAUSTED)
def test_random_actions_exhaust_a_game(name: str) -> None:
    """Actions never repeat what is known to be wrong, so that a random agent with turns enough wins."""
    env = gem.make(f"game:{name}", **EXHAUSTED[name])
    assert all(played(env, seed)[-1][4]["correct"] for seed in range(3))


@pytest.mark.parametrize("env_id", [env_id for env_id in RANDOM if env_id[5:].partition("-")[0] not in NO_GOLD])
def test_gold_actions_win(env_id: str) -> None:
    """Played turn by turn, also after a random action, they win within the turns that there are."""
    env = gem.make(env_id)
    for seed in range(3):
        env.reset(seed=seed)
        *_, over, _, info = env.step(env.sample_random_action())
        while not over:
            *_, over, _, info = env.step(env.gold_action())
        assert info["correct"]
        assert env.gold_action() is None


@pytest.mark.parametrize("copied", [lambda env: env.fork(), lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("env_id", IDS)
def test_fork_goes_on_identically(env_id: str, copied: Any) -> None:
    """In the middle, with what is drawn and rendered, and into the next episode."""
    env: Any = gem.make(env_id, render_mode="ansi")
    env.reset(seed=5)
    assert env.render() != "The game has not begun."
    for _ in range(2):
        if not env.step(env.sample_random_action())[2]:
            other = copied(env)
            drawn = env.render()
            assert (other.render(), other.sample_random_action()) == (drawn, env.sample_random_action())
            assert played(other, None) == played(env, None)
            env.reset(seed=5)


@pytest.mark.thorough
@pytest.mark.parametrize("env_id", IDS)
def test_keeps_the_contract(env_id: str) -> None:
    check_env(env_id)


@pytest.mark.thorough
@pytest.mark.parametrize("env_id", IDS)
def test_random_episodes(env_id: str) -> None:
    """No sampled action is lost, turns are counted down, and seeds differ; there is an action after the end."""
    env = gem.make(env_id)
    first = [played(env, seed) for seed in range(20)]
    assert len({repr(records) for records in first}) == 20
    for seed, records in enumerate(first):
        env.reset(seed=seed)
        for number, record in enumerate(records[1:], start=1):
            assert record[-1]["parsed_action"] is not None
            assert ("correct" in record[-1]) is record[2]
            assert record[2] or f"Turns left: {env.unwrapped.max_turns - number}." in record[0]
        assert sum(record[1] for record in records[1:]) <= 1 + 1e-9
    assert re.fullmatch(r"\\boxed\{.+\}", env.sample_random_action())


@pytest.mark.thorough
@pytest.mark.parametrize("format_error_ends", [True, False])
@pytest.mark.parametrize("env_id", IDS)
def test_hostile_responses_are_answered_briefly(env_id: str, format_error_ends: bool) -> None:
    """By nothing or a format error, which may end the game; what is said stays printable. ``check_env`` times it."""
    env = gem.make(env_id, format_error_ends=format_error_ends)
    prompt, _ = env.reset(seed=0)
    does = "ends the game" if format_error_ends else "costs a turn"
    assert f"A response without one {does}; " in prompt
    for response in HOSTILE:
        _, info = env.reset(seed=0)
        observation, reward, terminated, truncated, _ = env.step(response)
        assert len(observation) < len(info["suffix"]) + LONGEST_FEEDBACK
        assert observation.encode()
        assert "\x1b" not in observation
        assert reward in (0.0, FORMAT_ERROR[env_id])
        assert not truncated
        assert terminated == (format_error_ends and reward == FORMAT_ERROR[env_id])


@given(st.sampled_from(IDS), st.integers(0, 100), st.lists(ANSWERS, max_size=30), st.booleans())
def test_rewards_stay_within_bounds(env_id: str, seed: int, answers: list[str], format_error_ends: bool) -> None:
    """Whatever is said, a game pays no less a turn than for a format error, and at most 1 in all."""
    env = gem.make(env_id, format_error_ends=format_error_ends)
    env.reset(seed=seed)
    total = 0.0
    for answer in answers:
        _, reward, terminated, truncated, _ = env.step(f"\\boxed{{{answer}}}")
        assert not truncated
        assert FORMAT_ERROR[env_id] <= reward <= 1
        total += reward
        if terminated:
            break
    assert total <= 1 + 1e-9


BEHIND = {
    "GuessTheNumber-v0": ("25", "your guess"),
    "Mastermind-v0-easy": ("1 2", "1, 2"),
    "TowerofHanoi-v0-easy": ("A C", "done"),
    "Wordle-v0-hard": ("house", "\\text{house}"),
    "Hangman-v0-easy": ("e", "your guess"),
    "Crosswords-v0-easy": ("0 3 E", "row col letter"),
    "WordSearch-v0-easy": ("2 0 2 5", "2 0"),
    "Minesweeper-v0-easy": ("reveal 0 1", "reveal"),
    "FifteenPuzzle-v0-hard": ("up", "direction"),
    "Sudoku-v0-easy": ("1 2 3", "1 2"),
    "Game2048-v0-easy": ("left", "2048"),
    "Sokoban-v0-easy": ("up", "push up"),
}


@pytest.mark.parametrize("name", BEHIND)
def test_box_without_the_form_of_an_answer_is_passed_over(name: str) -> None:
    """As in gem-llm, which plays the last box that has the form of a move; empty and unfinished ones are none."""
    env = gem.make(f"game:{name}")
    env.reset(seed=0)
    answer, behind = BEHIND[name]
    result = env.step(box(answer))
    for rest in (box(behind), "\\boxed{}", "\\boxed{ \n}", "\\boxed{", "\\boxed{} \\boxed{}"):
        env.reset(seed=0)
        assert env.step(f"{box(answer)} I put it as {rest}.") == result
    assert "cannot be read" not in result[0]


@given(st.integers(-(10**200), 10**200))
def test_whole_number_reads_what_python_writes(number: int) -> None:
    read = whole_number(str(number))
    assert read == number if len(str(number)) <= 100 else abs(read or 0) >= 10**98


@given(st.text(max_size=12))
def test_readers_never_fail(text: str) -> None:
    read = whole_number(text)
    assert read == (int(text) if re.fullmatch(r"[+-]?[0-9]+", text) else None)
    assert len(quote(text * 40)) < 450
    assert quote(text).encode()
    ways = ("up", "down", "left", "right")
    assert read_direction(text) == (text.lower() if text.lower() in ways else None)
    assert [read_direction(way.title()) for way in ways] == list(ways)


@given(st.lists(st.integers(-99, 99), min_size=1), st.sampled_from([" ", "  ", "\n", "\t "]))
def test_whole_numbers_reads_lists(numbers: list[int], space: str) -> None:
    assert whole_numbers(space.join(map(str, numbers))) == numbers
