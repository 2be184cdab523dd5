"""The rewards of each game, row by row as gem-llm gives them, and what each turn says."""

from __future__ import annotations

from typing import Any

import pytest

import gem_core as gem
from gem_games.guess_the_number import GuessTheNumberEnv
from gem_games.mastermind import MastermindEnv, count_pegs
from gem_games.tower_of_hanoi import TowerOfHanoiEnv


def box(answer: object) -> str:
    return f"I say \\boxed{{{answer}}}."


def guessing(number: int = 30, **kwargs: Any) -> GuessTheNumberEnv:
    """Return a game of 1 to 50 whose number is known."""
    env = GuessTheNumberEnv(**kwargs)
    env.reset(seed=0)
    env.number = number
    return env


def mastermind(*code: int, **kwargs: Any) -> MastermindEnv:
    """Return a game whose code is known."""
    env = MastermindEnv(code_length=len(code), **kwargs)
    env.reset(seed=0)
    env.code = list(code)
    return env


def hanoi(**kwargs: Any) -> TowerOfHanoiEnv:
    env = TowerOfHanoiEnv(**kwargs)
    env.reset(seed=0)
    return env


def test_guess_right_wins_with_one() -> None:
    observation, reward, terminated, truncated, info = guessing(30).step(box(30))
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert (info["correct"], info["parsed_action"]) == (True, "30")
    assert observation.startswith("30 is right: you found the number.\n")
    assert observation.endswith("The game is over: you won.")


@pytest.mark.parametrize(("guess", "hint"), [(29, "higher than 29"), (31, "lower than 31")])
def test_guess_wrong_gives_a_hint_and_nothing(guess: int, hint: str) -> None:
    _, reward, terminated, truncated, info = guessing(30).step(box(guess))
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert info["feedback"] == f"The number is {hint}."
    assert info["suffix"] == (
        f"\nThe number is from 1 to 50. Hints so far: {hint}.\nTurns left: 9. Put your guess inside \\boxed{{}}."
    )
    assert "correct" not in info


@pytest.mark.parametrize("answer", ["0", "51", "-3", "+99", "9" * 5_000, "-" + "1" * 5_000, "0" * 5_000])
def test_guess_outside_the_range_is_invalid_and_no_format_error(answer: str) -> None:
    """Unlike in gem-llm, 0 is a number like any other."""
    observation, reward, terminated, _, info = guessing().step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert "is outside the range. The turn is lost." in info["feedback"]
    assert len(observation) < 400


@pytest.mark.parametrize("answer", ["030", "+30", " 30 ", "0" * 5_000 + "30"])
def test_guess_may_have_zeros_sign_and_space(answer: str) -> None:
    assert guessing(30).step(box(answer))[1] == 1.0


def test_guess_made_before_is_invalid() -> None:
    env = guessing(30)
    env.step(box(20))
    _, reward, terminated, _, info = env.step(box(20))
    assert (reward, terminated, info["feedback"]) == (0.0, False, "You have guessed 20 before. The turn is lost.")


@pytest.mark.parametrize(
    ("answer", "reward"),
    [(30, 1.0), (20, 1 - 10 / 49), (50, 1 - 20 / 49), (1, 1 - 29 / 49), (0, 0.0), (51, 0.0), ("x", -0.1)],
)
def test_last_guess_is_rewarded_by_its_distance(answer: object, reward: float) -> None:
    env = guessing(30, max_turns=2)
    env.step(box(1))
    observation, got, terminated, truncated, info = env.step(box(answer))
    assert got == pytest.approx(reward)
    assert (terminated, truncated, info["correct"]) == (True, False, answer == 30)
    if answer != 30:
        assert "The number was 30." in observation
        assert observation.endswith("The game is over: you lost.")


NO_NUMBERS = [
    "",
    "abc",
    "3.5",
    "1e1",
    "--3",
    "+",
    "3 4",
    "\u0661\u0662",
    "\uff12\uff15",
    "\u00b2",
    "1_0",
    "0x1F",
    "True",
    "\x00",
    "\ud800",
]


@pytest.mark.parametrize("answer", NO_NUMBERS)
def test_guess_that_is_no_number_ends_the_game(answer: str) -> None:
    """Only ASCII digits are read, as anyone can write them."""
    observation, reward, terminated, truncated, info = guessing(30).step(box(answer))
    assert (reward, terminated, truncated) == (-0.1, True, False)
    assert (info["correct"], info["parsed_action"]) == (False, None)
    assert "is not a whole number. That ends the game. The number was 30." in observation


@pytest.mark.parametrize("response", ["", "30", "\\boxed30", "\\boxed{30", "boxed{30}"])
@pytest.mark.parametrize("make", [guessing, lambda **k: mastermind(1, 2, **k), hanoi])
def test_response_without_a_box_is_a_format_error(make: Any, response: str) -> None:
    _, reward, terminated, _, info = make().step(response)
    assert (reward, terminated) == (-0.1, True)
    assert info["feedback"].startswith("Your response has no complete \\boxed{}. That ends the game.")


@pytest.mark.parametrize("make", [guessing, lambda **k: mastermind(1, 2, **k), hanoi])
def test_format_error_may_go_on(make: Any) -> None:
    """With format_error_ends=False it costs a turn, and ends the game only in the last one."""
    env = make(format_error_ends=False, max_turns=2)
    _, reward, terminated, _, info = env.step("what?")
    assert (reward, terminated, info["parsed_action"]) == (-0.1, False, None)
    assert info["feedback"] == "Your response has no complete \\boxed{}. The turn is lost."
    assert "Turns left: 1." in info["suffix"]
    _, reward, terminated, truncated, info = env.step("what?")
    assert (reward, terminated, truncated, info["correct"]) == (-0.1, True, False, False)


def test_the_last_box_counts() -> None:
    assert guessing(30).step("\\boxed{3} or rather \\boxed{30}")[1] == 1.0


@pytest.mark.parametrize(
    ("guess", "code", "pegs"),
    [
        ((1, 2, 3, 4), (1, 2, 3, 4), (4, 0)),
        ((1, 2, 3, 4), (4, 3, 2, 1), (0, 4)),
        ((1, 1, 2, 2), (1, 2, 1, 3), (1, 2)),
        ((5, 5, 5, 5), (5, 1, 2, 5), (2, 0)),
        ((1, 2), (3, 4), (0, 0)),
    ],
)
def test_pegs(guess: tuple[int, ...], code: tuple[int, ...], pegs: tuple[int, int]) -> None:
    assert count_pegs(guess, code) == pegs


def test_mastermind_rewards_new_black_pegs_and_add_up_to_one() -> None:
    env = mastermind(1, 2, 3, 4, num_numbers=8)
    rewards = []
    for guess in ("1 5 6 7", "5 2 6 7", "1 2 3 5", "4 3 2 1", "1 2 3 4"):
        observation, reward, terminated, truncated, info = env.step(box(guess))
        rewards.append(reward)
    assert rewards == [0.25, 0.0, 0.5, 0.0, 0.25]
    assert (terminated, truncated, info["correct"]) == (True, False, True)
    assert info["parsed_action"] == "1 2 3 4"
    assert "4 3 2 1: 0 black, 4 white" in observation


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("1 2 3", "Your guess has length 3, and the code has length 4."),
        ("1234", "Your guess has length 1, and the code has length 4."),
        ("1 2 3 9", "Your guess has a number that is not from 1 to 8."),
        ("0 1 2 3", "Your guess has a number that is not from 1 to 8."),
        (f"1 2 3 {'4' * 500}", "Your guess has a number that is not from 1 to 8."),
    ],
)
def test_mastermind_invalid_guess_gives_nothing(answer: str, feedback: str) -> None:
    _, reward, terminated, _, info = mastermind(1, 2, 3, 4, num_numbers=8).step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."


def test_mastermind_repeated_guess_is_invalid_and_repeated_numbers_are_not() -> None:
    env = mastermind(1, 2, 3, 4, num_numbers=8)
    assert env.step(box("1 1 1 1"))[1] == 0.25
    _, reward, _, _, info = env.step(box("1 1 1 01"))
    assert (reward, info["feedback"]) == (0.0, "You have made this guess before. The turn is lost.")


@pytest.mark.parametrize("answer", ["", "a b", "1,2,3,4", "1 2 3 x", "1 2 3 \uff14", "1 " * 5_000, "1.0 2 3 4"])
def test_mastermind_other_text_is_a_format_error(answer: str) -> None:
    observation, reward, terminated, _, info = mastermind(1, 2, 3, 4, num_numbers=8).step(box(answer))
    assert (reward, terminated, info["correct"]) == (-0.1, True, False)
    assert "The code was 1 2 3 4." in observation
    assert len(observation) < 500


@pytest.mark.parametrize(("answer", "reward"), [("1 5", 0.5), ("5 6", 0.0), ("1", 0.0), ("x", -0.1), ("1 2", 1.0)])
def test_mastermind_last_turn_is_rewarded_like_any_other(answer: str, reward: float) -> None:
    _, got, terminated, truncated, info = mastermind(1, 2, max_turns=1).step(box(answer))
    assert (got, terminated, truncated, info["correct"]) == (reward, True, False, reward == 1.0)


SOLUTION = ["A C", "A B", "C B", "A C", "B A", "B C", "A C"]


def test_hanoi_solved_gives_one() -> None:
    env = hanoi(num_disks=3, max_turns=10)
    results = [env.step(box(move)) for move in SOLUTION]
    assert [result[1] for result in results] == [0.0] * 6 + [1.0]
    assert [result[2] for result in results] == [False] * 6 + [True]
    observation, *_, truncated, info = results[-1]
    assert (truncated, info["correct"], info["parsed_action"]) == (False, True, "A C")
    assert "A: empty\nB: empty\nC: 3 2 1\nThe game is over: you won." in observation


@pytest.mark.parametrize("answer", ["A C", "a c", "AC", "A,C", "a , C", "A\tC"])
def test_hanoi_reads_two_pegs(answer: str) -> None:
    _, reward, terminated, _, info = hanoi().step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, "A C")
    assert info["feedback"] == "Disk 1 went from peg A to peg C."
    assert "\nA: 3 2\nB: empty\nC: 1\n" in info["suffix"]


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("B C", "Peg B is empty."),
        ("B B", "Peg B is empty."),
        ("A A", "A move must go to another peg."),
        ("A C", "Disk 2 may not lie on disk 1, which is smaller."),
    ],
)
def test_hanoi_illegal_move_changes_nothing(answer: str, feedback: str) -> None:
    env = hanoi()
    env.step(box("A C"))
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."
    assert env.pegs == {"A": [3, 2], "B": [], "C": [1]}


@pytest.mark.parametrize("answer", ["", "A", "A D", "A B C", "1 3", "A->C", "\u0410 \u0421", "A" + " " * 100_000 + "X"])
def test_hanoi_other_text_is_a_format_error(answer: str) -> None:
    """The last but one is Cyrillic; the last would take a careless pattern minutes."""
    _, reward, terminated, _, info = hanoi().step(box(answer))
    assert (reward, terminated, info["correct"]) == (-0.1, True, False)


@pytest.mark.parametrize(("moves", "reward"), [(["A C"], 1 / 3), (["A B"], 0.0), (["A C", "C C"], 1 / 3)])
def test_hanoi_limit_rewards_the_disks_on_the_goal(moves: list[str], reward: float) -> None:
    env = hanoi(num_disks=3, max_turns=len(moves))
    *_, (_, got, terminated, truncated, info) = [env.step(box(move)) for move in moves]
    assert got == pytest.approx(reward)
    assert (terminated, truncated, info["correct"]) == (True, False, False)
    assert info["feedback"].endswith("You have used all your turns.")


@pytest.mark.parametrize(
    ("maker", "arguments", "message"),
    [
        (GuessTheNumberEnv, {"min_number": "1"}, "min_number must be a whole number"),
        (GuessTheNumberEnv, {"max_turns": 0}, "max_turns must be a whole number from 1"),
        (GuessTheNumberEnv, {"max_turns": True}, "not True"),
        (GuessTheNumberEnv, {"min_number": 5, "max_number": 5}, "min_number must be below max_number, not 5 with 5"),
        (GuessTheNumberEnv, {"format_error_ends": 1}, "format_error_ends must be True or False, not 1"),
        (MastermindEnv, {"code_length": 0}, "code_length must be a whole number from 1 to 20"),
        (MastermindEnv, {"code_length": 5, "num_numbers": 4}, "raise num_numbers, or allow duplicate_numbers"),
        (MastermindEnv, {"duplicate_numbers": "no"}, "duplicate_numbers must be True or False"),
        (TowerOfHanoiEnv, {"num_disks": 2.0}, "num_disks must be a whole number from 1 to 20"),
        (TowerOfHanoiEnv, {"num_disks": 7, "max_turns": None}, "leave solvable; give both"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(maker: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(gem.GemError, match=message):
        maker(**arguments)
