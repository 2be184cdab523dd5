r"""The verdict on each kind of answer, game by game: reward, whether it ends the game, and what was played.

The rewards are those that gem-llm gives, row by row.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

import gem_core as gem
from gem_games.crosswords import CrosswordsEnv, Placed
from gem_games.fifteen_puzzle import FifteenPuzzleEnv
from gem_games.game import Game
from gem_games.game_2048 import Game2048Env
from gem_games.guess_the_number import GuessTheNumberEnv
from gem_games.hangman import HangmanEnv
from gem_games.mastermind import MastermindEnv
from gem_games.minesweeper import MinesweeperEnv
from gem_games.sokoban import SokobanEnv
from gem_games.sudoku import SudokuEnv
from gem_games.tower_of_hanoi import TowerOfHanoiEnv
from gem_games.word_search import WordSearchEnv
from gem_games.wordle import WordleEnv

Maker = Callable[..., Game]


def begun(env: Any, **position: Any) -> Any:
    """Return a game that was dealt, and then put into a position."""
    env.render_mode = "ansi"
    env.reset(seed=0)
    vars(env).update(position)
    return env


def guessing(**kwargs: Any) -> Any:
    """Find 30 among 1 to 50."""
    return begun(GuessTheNumberEnv(**kwargs), number=30)


def mastermind(**kwargs: Any) -> Any:
    """Find 1 2 3 4, of numbers up to 8."""
    return begun(MastermindEnv(4, 8, **kwargs), code=[1, 2, 3, 4])


def hanoi(**kwargs: Any) -> Any:
    return begun(TowerOfHanoiEnv(**{"num_disks": 3, **kwargs}))


def wordle(**kwargs: Any) -> Any:
    return begun(WordleEnv(5, **kwargs), word="CRANE")


def hangman(**kwargs: Any) -> Any:
    return begun(HangmanEnv(5, **kwargs), word="APPLE")


def crossword(**kwargs: Any) -> Any:
    """LAMP, across at the top, and MAP, down through its M."""
    env = begun(CrosswordsEnv(num_words=2, **kwargs), placed=[Placed(0, 0, True, "LAMP"), Placed(0, 2, False, "MAP")])
    env._begin()
    return env


def word_search(**kwargs: Any) -> Any:
    """TREE across at the top, STAR down on the right, and a TREE by chance, upwards on the left."""
    grid = ["TREES", "EXXXT", "EXXXA", "RXXXR", "TXXXX"]
    env = begun(WordSearchEnv(num_words=2, **kwargs), words=["STAR", "TREE"], grid=grid)
    env._begin()
    return env


def field(*mines: int, **kwargs: Any) -> Any:
    """A board of 3 rows and 4 columns with one mine, in its first cell."""
    env = begun(MinesweeperEnv(3, 4, len(mines) or 1, **kwargs))
    env._set_mines(frozenset(mines or {0}))
    return env


def sudoku(**kwargs: Any) -> Any:
    """1234 3412 2143 4321, of which the first cell and the one in row 2, column 2 are empty."""
    solution = [1, 2, 3, 4, 3, 4, 1, 2, 2, 1, 4, 3, 4, 3, 2, 1]
    env = begun(SudokuEnv(clues=14, scale=4, **kwargs), solution=solution)
    env._put([0 if cell in (0, 5) else number for cell, number in enumerate(solution)])
    return env


def sliding(**kwargs: Any) -> Any:
    """The gap and 1 above 3 and 2."""
    env = begun(FifteenPuzzleEnv(num_rows=2, **kwargs))
    env._put([b" _", b" 1", b" 3", b" 2"])
    return env


def corridor(**kwargs: Any) -> Any:
    """Two rows between walls: ``@$.-`` above ``-$-.``."""
    env = begun(SokobanEnv((5, 7), num_boxes=2, **kwargs))
    env._set_cells("########@$.-###-$-.#########")
    return env


def merging(**kwargs: Any) -> Any:
    """Two tiles of 2 side by side; the aim is a tile of 16, three steps away."""
    board = [(2, 2, 0), (0, 0, 0), (0, 0, 0)]
    return begun(Game2048Env(16, board_size=3, **kwargs), board=board, first_tile=2, largest_tile=2)


GRIDS = [field, sudoku, sliding, corridor, merging]
MAKERS = [guessing, mastermind, hanoi, wordle, hangman, crossword, word_search, *GRIDS]
"""All games of one player but WikiGame."""
SECRETS = {guessing: "30", mastermind: "1 2 3 4", wordle: "CRANE", hangman: "APPLE", crossword: "LAMP, MAP"}
"""What is told when a game is lost, by game."""


def says(answer: object) -> str:
    return f"I say \\boxed{{{answer}}}."


GAMES: list[tuple[Maker, list[str], list[float]]] = [
    (guessing, ["20", "31", "30"], [0, 0, 1]),
    (guessing, ["030"], [1]),
    (guessing, ["0" * 5_000 + "30"], [1]),
    (mastermind, ["1 5 6 7", "5 2 6 7", "1 2 3 5", "4 3 2 1", "1 2 3 4"], [0.25, 0, 0.5, 0, 0.25]),
    (hanoi, ["A C", "ab", "C , B", "a c", "B\tA", "B C", "A C"], [0, 0, 0, 0, 0, 0, 1]),
    (wordle, ["cried", "crate", "brand", "c r a n e"], [0.2, 0.2, 0.1, 0.5]),
    (wordle, ["Cr\nane"], [1]),
    (hangman, ["p", "z", "E", "angle", "apple"], [0.2, 0, 0.1, 0, 0.7]),
    (hangman, ["a", "p", "l", "e", "apple"], [0.1, 0.2, 0.1, 0.1, 0.5]),
    (crossword, ["0 0 L", "0 1 a", "0 2 m", "0 3 p", "1 2 A", "2 2 p"], [1 / 6] * 6),
    (word_search, ["0 0 0 3", "2 4 0 4", "1 1 1 1", "0 4 3 4"], [0.5, 0, 0, 0.5]),
    (word_search, ["4 0 1 0", "00 0 +0 3", "3 4 0 4"], [0.5, 0, 0.5]),
    (field, ["flag 0 0", "FLAG 0 0", "reveal 0 1", "Reveal  2 3"], [0, 0, 1 / 11, 10 / 11]),
    (field, ["flag 0 3", "reveal 2 3", "flag 0 3", "reveal 0 3"], [0, 10 / 11, 0, 1 / 11]),
    (sudoku, ["1 1 1", " 2  2\t04 "], [0.5, 0.5]),
    (sliding, ["up", "down", "left", "right", "Left", "up"], [0] * 5 + [1]),
    (corridor, ["down", "Right", "right", "left", "left", "up", "right"], [0] * 6 + [1]),
]


@pytest.mark.parametrize(("make", "answers", "rewards"), GAMES)
def test_game_is_won_by_answers_whose_rewards_add_up_to_one(
    make: Maker, answers: list[str], rewards: list[float]
) -> None:
    """The last answer wins, none before it ends the game, and each was played."""
    env = make()
    results = [env.step(says(answer)) for answer in answers]
    assert [result[1] for result in results] == pytest.approx(rewards)
    assert [result[2] for result in results] == [False] * (len(answers) - 1) + [True]
    assert all(result[4]["parsed_action"] is not None for result in results)
    assert results[-1][4]["correct"] is True
    assert sum(rewards) == pytest.approx(1)


@pytest.mark.parametrize(
    ("make", "before", "answers"),
    [
        (guessing, ["20"], ["0", "51", "-3", "+99", "9" * 5_000, "-" + "1" * 5_000, "20"]),
        (mastermind, ["1 1 1 1"], ["1 2 3", "1234", "1 2 3 9", "0 1 2 3", f"1 2 3 {'4' * 500}", "1 1 1 01"]),
        (hanoi, ["A C"], ["B C", "B B", "A A", "A C"]),
        (wordle, ["crate"], ["cranes", "c", "x" * 10_000, "xqzjk", "crate"]),
        (hangman, ["p", "angle"], ["P", "Angle", "apples", "y" * 10_000]),
        (crossword, ["0 0 L", "0 1 X"], ["3 0 A", "-1 0 A", f"0 {'9' * 500} A", "1 0 A", "0 0 A", "0 1 x"]),
        (field, ["flag 0 0", "reveal 0 1"], ["reveal 0 1", "flag 0 1", "reveal 0 0", "reveal 3 0", "open 0 2"]),
        (field, ["flag 0 0"], ["flag 0 4", "reveal -1 0", "reveal 0 " + "9" * 500]),
        (sudoku, ["1 1 1"], ["1 2 2", "0 1 1", "1 5 1", "1 1 -1", "1 1 " + "9" * 500]),
        (sliding, [], ["down", "right"]),
        (corridor, ["right"], ["up", "down"]),
        (corridor, ["right", "right"], ["right"]),
        (merging, [], ["up"]),
        (word_search, ["0 0 0 2"], ["0 0 0 5", "-1 0 0 0", f"0 0 0 {'9' * 500}", "0 0 3 3", "0 0 0 2", "0 2 0 0"]),
    ],
)
def test_answer_that_breaks_a_rule_gives_nothing_and_costs_a_turn(
    make: Maker, before: list[str], answers: list[str]
) -> None:
    """Out of range, of another length, said before; nothing changes."""
    for answer in answers:
        env = make()
        for earlier in before:
            env.step(says(earlier))
        board = env.render().rpartition("turn ")[0]
        observation, reward, terminated, _, info = env.step(says(answer))
        assert (reward, terminated, info["parsed_action"]) == (0.0, False, None), answer
        assert env.turn == len(before) + 1
        assert env.render().rpartition("turn ")[0] == board
        assert len(observation) < 700


NO_NUMBERS = "", "abc", "3.5", "1e1", "--3", "+", "3 4", "\u0661\u0662", "\uff12\uff15", "\u00b2", "1_0", "0x1F", "\x00"
WORDS = "", "cr4ne", "crane!", "cräne", "ｃｒａｎｅ", "\u0430", "\x00", "\ud800"


@pytest.mark.parametrize(
    ("make", "answers"),
    [
        (guessing, NO_NUMBERS),
        (mastermind, ["", "a b", "1,2,3,4", "1 2 3 x", "1 2 3 \uff14", "1 " * 5_000, "1.0 2 3 4"]),
        (hanoi, ["", "A", "A D", "A B C", "1 3", "A->C", "\u0410 \u0421", "A" + " " * 100_000 + "X"]),
        (wordle, [*WORDS, "c" + " " * 2_000 + "rane"]),
        (hangman, [*WORDS, "4", "a,b"]),
        (crossword, ["", "0 0", "L 0 0", "0 0 LA", "0 0 1", "0 0 é", "0,0,L", "0.0 0 L", "0 0 " + " " * 2_000 + "L"]),
        (field, ["", "reveal", "1 1", "reveal 1 1 1", "reveal a b", "reveal 1,1", "reveal \u0661 1", "\ud800"]),
        (sudoku, ["", "1 1", "1 1 1 1", "a b c", "1,1,1", "1.0 1 1", "\u0661 1 1", "\x00", "\ud800"]),
        *[(make, ["", "north", "u", "5", "up up", "\x00", "\ud800"]) for make in (sliding, corridor, merging)],
        (word_search, ["", "0 0 0", "0 0 0 3 4", "TREE", "0,0,0,3", "[0 0 0 3]", "0 0 0 ３", "1 " * 5_000]),
    ],
)
def test_other_text_is_a_format_error(make: Maker, answers: list[str]) -> None:
    """It ends the game, which tells its secret; only ASCII letters and digits are read."""
    for response in ["", "30", "\\boxed30", "\\boxed{30", *map(says, answers)]:
        observation, reward, terminated, truncated, info = make().step(response)
        assert (reward, terminated, truncated) == (-0.1, True, False), response
        assert (info["correct"], info["parsed_action"]) == (False, None)
        assert SECRETS.get(make, "") in observation
        assert len(observation) < 1_000


@pytest.mark.parametrize("make", MAKERS)
def test_format_error_may_go_on(make: Maker) -> None:
    """With format_error_ends=False it costs a turn, and ends the game only in the last one."""
    env = make(format_error_ends=False, max_turns=10)
    env.turn = 8
    assert env.step("what?")[1:3] == (-0.1, False)
    _, reward, terminated, truncated, info = env.step("what?")
    assert (reward, terminated, truncated, info["correct"]) == (-0.1, True, False, False)


LAST_TURNS: list[tuple[Maker, dict[object, float]]] = [
    (guessing, {30: 1, 20: 1 - 10 / 49, 50: 1 - 20 / 49, 1: 1 - 29 / 49, 0: 0, 51: 0, "x": -0.1}),
    (mastermind, {"1 5 6 7": 0.25, "5 6 7 8": 0, "1": 0, "x": -0.1, "1 2 3 4": 1}),
    (hanoi, {"A C": 1 / 3, "A B": 0, "C C": 0, "x": -0.1}),
    (wordle, {"crate": 0.4, "sloth": 0, "xqzjk": 0, "crane": 1, "1": -0.1}),
    (hangman, {"p": 0.2, "z": 0, "apple": 1, "1": -0.1, "ab": 0}),
    (crossword, {"0 0 L": 1 / 6, "0 0 X": 0, "9 9 X": 0, "x": -0.1}),
    (word_search, {"0 0 0 3": 0.5, "9 9 9 9": 0, "x": -0.1}),
    (field, {"reveal 0 1": 1 / 11, "flag 0 0": 0, "reveal 0 0": 0, "x": -0.1}),
    (sudoku, {"2 2 4": 0.5, "2 2 3": 0, "9 9 9": 0, "x": -0.1}),
    (sliding, {"up": 0, "left": 0.5, "down": 0.25, "x": -0.1}),
    (corridor, {"right": 0.5, "down": 0, "up": 0, "x": -0.1}),
    (merging, {"left": 1 / 3, "up": 0, "x": -0.1}),
]


@pytest.mark.parametrize(("make", "rewards"), LAST_TURNS)
def test_last_turn(make: Maker, rewards: dict[object, float]) -> None:
    """It is terminated, not truncated; some games pay for how near one came."""
    for answer, reward in rewards.items():
        env = make(max_turns=10)
        env.turn = 9
        observation, got, terminated, truncated, info = env.step(says(answer))
        assert got == pytest.approx(reward), answer
        assert (terminated, truncated, info["correct"]) == (True, False, reward == 1)
        assert reward == 1 or SECRETS.get(make, "") in observation


@pytest.mark.parametrize(
    ("make", "answers", "shown"),
    [
        (guessing, ["29"], "The number is from 1 to 50. Hints so far: higher than 29."),
        (guessing, ["31"], "The number is from 1 to 50. Hints so far: lower than 31."),
        (mastermind, ["4 3 2 1"], "4 3 2 1: 0 black, 4 white"),
        (hanoi, ["A C"], "\nA: 3 2\nB: empty\nC: 1\n"),
        (wordle, ["cried", "brand"], "CRIED: G G X Y X\nBRAND: X G G G X\n"),
        (hangman, ["p", "z", "angle"], "_ P P _ _\nTried so far: P, Z, ANGLE."),
        (crossword, ["0 0 L"], "    0  1  2  3\n 0  L  _  _  _\n 1  .  .  _  .\n 2  .  .  _  .\n"),
        (crossword, ["0 0 X"], "Wrong so far: 0 0 X."),
        (crossword, [], "across from row 0 column 0, 4 letters: "),
        (field, ["reveal 0 1", "flag 0 0"], "     0  1  2  3\n  0  F  1  .  .\n"),
        (sudoku, ["1 1 1"], "  1 2   3 4\n1 1 2 | 3 4\n2 3 . | 1 2\n  ----+----\n"),
        (sliding, ["up"], "\n 3  1\n _  2\n"),
        (corridor, ["down", "right"], "# - $ . - # #\n# - @ $ . # #\n"),
        (word_search, ["0 0 0 3"], "Words to find: STAR.\n    0  1  2  3  4\n 0  t  r  e  e  S\n"),
    ],
)
def test_situation_shows_what_is_known(make: Maker, answers: list[str], shown: str) -> None:
    """To a player who sees nothing else."""
    env = make(format_error_ends=False)
    for answer in [*answers, "a lost turn"]:
        observation, _, _, _, info = env.step(says(answer))
    assert shown in info["suffix"]
    assert observation == info["feedback"] + info["suffix"]


@pytest.mark.parametrize(
    ("make", "answers", "drawing"),
    [
        (guessing, ["20"], "open: 21 to 50 · guesses: 20"),
        (mastermind, ["1 1 1 4"], "1.  1   1   1   4   ●●"),
        (hanoi, ["A C"], "  A       B       C"),
        (wordle, ["crate"], "  C R A T E"),
        (hangman, ["p", "angle"], "_ P P _ _"),
        (crossword, ["0 0 L"], "L"),
        (word_search, ["0 0 0 3"], "STAR"),
        (field, ["reveal 0 1", "flag 0 0"], " 0  F 1 ■ ■"),
        (sudoku, ["1 1 1"], "1 1 2 | 3 4"),
        (sliding, ["up"], "  3  1\n  ·  2"),
        (corridor, [], "☺ ■ ◇"),
        (merging, [], "2     2     ·"),
    ],
)
def test_drawing_shows_the_state(make: Maker, answers: list[str], drawing: str) -> None:
    env = make()
    for answer in answers:
        env.step(says(answer))
    assert drawing in re.sub(r"\x1b\[\d+m", "", str(env.render()))


@pytest.mark.parametrize("make", MAKERS)
def test_drawing_is_coloured_and_says_who_lost(make: Maker) -> None:
    """Every colour ends on its line."""
    env = make()
    env.step("what?")
    drawn = str(env.render())
    assert "\x1b[31mlost\x1b[0m" in drawn
    for line in drawn.splitlines():
        assert re.sub(r"\x1b\[\d+m[^\x1b]+\x1b\[0m", "", line).count("\x1b") == 0


@pytest.mark.parametrize(
    ("maker", "arguments", "value"),
    [
        (GuessTheNumberEnv, {"max_turns": 0}, "max_turns"),
        (GuessTheNumberEnv, {"min_number": 5, "max_number": 5}, "5 with 5"),
        (MastermindEnv, {"code_length": 0}, "code_length"),
        (MastermindEnv, {"code_length": 5, "num_numbers": 4}, "num_numbers"),
        (TowerOfHanoiEnv, {"num_disks": 7, "max_turns": None}, "give both"),
        (WordleEnv, {"word_length": 2}, "word_length"),
        (HangmanEnv, {"word_length": 16}, "word_length"),
        (CrosswordsEnv, {"hardcore": "no"}, "'no'"),
        (CrosswordsEnv, {"num_words": 21}, "num_words"),
        (CrosswordsEnv, {"num_words": 4, "max_turns": 19}, "20 for 4"),
        (WordSearchEnv, {"num_words": 5, "max_turns": 4}, "4 with 5"),
        (MinesweeperEnv, {"rows": 4, "cols": 4, "num_mines": 8}, "1 to 7 mines"),
        (FifteenPuzzleEnv, {"num_rows": 1}, "num_rows"),
        (SudokuEnv, {"scale": 16}, "scale"),
        (SudokuEnv, {"clues": 31, "max_turns": 49}, "max_turns=49"),
        (Game2048Env, {"target_tile": 100}, "100"),
        (Game2048Env, {"target_tile": 32, "board_size": 2}, "8 to 16"),
        (SokobanEnv, {"dim_room": (5, 5), "num_boxes": 3}, "2 boxes"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(maker: Any, arguments: dict[str, Any], value: str) -> None:
    with pytest.raises(gem.GemError, match=value):
        maker(**arguments)
