"""The rewards of the word games, row by row as gem-llm gives them, and what each turn says."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem
from gem_games.crosswords import CrosswordsEnv, Placed
from gem_games.hangman import HangmanEnv
from gem_games.word_search import WordSearchEnv
from gem_games.wordle import WordleEnv


def box(answer: object) -> str:
    return f"I say \\boxed{{{answer}}}."


def wordle(word: str = "CRANE", **kwargs: Any) -> WordleEnv:
    """Return a game whose word is known."""
    env = WordleEnv(word_length=len(word), **kwargs)
    env.render_mode = "ansi"
    env.reset(seed=0)
    env.word = word
    return env


def hangman(word: str = "APPLE", **kwargs: Any) -> HangmanEnv:
    env = HangmanEnv(word_length=len(word), **kwargs)
    env.render_mode = "ansi"
    env.reset(seed=0)
    env.word = word
    return env


def crossword(**kwargs: Any) -> CrosswordsEnv:
    """Return a crossword of LAMP, across at the top, and MAP, down through its M."""
    env = CrosswordsEnv(**{"num_words": 2, **kwargs})
    env.render_mode = "ansi"
    env.reset(seed=0)
    return put(env, placed=[Placed(0, 0, True, "LAMP"), Placed(0, 2, False, "MAP")])


def word_search(**kwargs: Any) -> WordSearchEnv:
    """Return a grid with TREE across at the top, STAR down on the right, and a TREE by chance, upwards on the left."""
    env = WordSearchEnv(**{"num_words": 2, **kwargs})
    env.render_mode = "ansi"
    env.reset(seed=0)
    return put(env, words=["STAR", "TREE"], grid=["TREES", "EXXXT", "EXXXA", "RXXXR", "TXXXX"])


def put(env: Any, **position: Any) -> Any:
    """Put a game into a position."""
    vars(env).update(position)
    env._begin()
    return env


GAMES = [wordle, hangman, crossword, word_search]


def uncoloured(env: Any) -> str:
    """Return what an environment draws without its colours."""
    return re.sub(r"\x1b\[\d+m", "", str(env.render()))


def test_wordle_right_wins_with_one() -> None:
    observation, reward, terminated, truncated, info = wordle().step(box("crane"))
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert (info["correct"], info["parsed_action"]) == (True, "CRANE")
    assert observation == (
        "CRANE is right: you found the word.\nThe word has 5 letters. Guesses so far:\nCRANE: G G G G G\n"
        "The game is over: you won."
    )


def test_wordle_rewards_new_green_places_and_adds_up_to_one() -> None:
    """A place that was green before gives nothing again."""
    env = wordle()
    results = [env.step(box(guess)) for guess in ("cried", "crate", "brand", "crane")]
    assert [result[1] for result in results] == pytest.approx([0.2, 0.2, 0.1, 0.5])
    assert results[2][4]["feedback"] == "BRAND is marked X G G G X."
    assert results[2][4]["suffix"] == (
        "\nThe word has 5 letters. Guesses so far:\nCRIED: G G X Y X\nCRATE: G G G X G\nBRAND: X G G G X\n"
        "Turns left: 17. Put your guess inside \\boxed{}."
    )


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("cranes", "Your guess has length 6, and the word has length 5."),
        ("c", "Your guess has length 1, and the word has length 5."),
        ("x" * 10_000, "Your guess has length 10000, and the word has length 5."),
        ("xqzjk", "XQZJK is not in the list of words."),
        ("crate", "You have guessed CRATE before."),
    ],
)
def test_wordle_invalid_guess_gives_nothing(answer: str, feedback: str) -> None:
    env = wordle()
    env.step(box("crate"))
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."
    assert list(env.guesses) == ["CRATE"]


def test_wordle_takes_any_letters_where_words_need_not_be_real() -> None:
    _, reward, _, _, info = wordle(only_real_words=False).step(box("xxaxx"))
    assert (reward, info["parsed_action"]) == (0.1, "XXAXX")


def test_wordle_accepts_rare_words() -> None:
    assert wordle().step(box("zesty"))[4]["parsed_action"] == "ZESTY"


@pytest.mark.parametrize("answer", ["CRANE", " crane ", "c r a n e", "Cr\nane"])
def test_wordle_reads_letters_in_any_case_and_with_spaces(answer: str) -> None:
    assert wordle().step(box(answer))[1] == 1.0


@pytest.mark.parametrize(
    "answer", ["", "cr4ne", "crane!", "cräne", "ｃｒａｎｅ", "\x00", "\ud800", "c" + " " * 2_000 + "rane"]
)
def test_wordle_other_text_is_a_format_error(answer: str) -> None:
    observation, reward, terminated, truncated, info = wordle().step(box(answer))
    assert (reward, terminated, truncated, info["correct"]) == (-0.1, True, False, False)
    assert "is not a word of the letters from A to Z. That ends the game. The word was CRANE." in observation


@pytest.mark.parametrize(
    ("answer", "reward"), [("crate", 0.4), ("sloth", 0.0), ("xqzjk", 0.0), ("crane", 1.0), ("1", -0.1)]
)
def test_wordle_last_turn_is_rewarded_like_any_other(answer: str, reward: float) -> None:
    observation, got, terminated, truncated, info = wordle(max_turns=1).step(box(answer))
    assert got == pytest.approx(reward)
    assert (terminated, truncated, info["correct"]) == (True, False, answer == "crane")
    assert answer == "crane" or "The word was CRANE." in observation


def test_hangman_letters_and_word_add_up_to_one() -> None:
    env = hangman()
    results = [env.step(box(guess)) for guess in ("p", "z", "E", "angle", "apple")]
    assert [result[1] for result in results] == pytest.approx([0.2, 0.0, 0.1, 0.0, 0.7])
    assert [result[4]["feedback"] for result in results] == [
        "The word has P in 2 places.",
        "The word has no Z.",
        "The word has E in 1 place.",
        "The word is not ANGLE.",
        "APPLE is right: you found the word.",
    ]
    assert results[3][4]["suffix"] == (
        "\nThe word has 5 letters: _ P P _ E\nTried so far: P, Z, E, ANGLE.\n"
        "Turns left: 16. Put a letter or the whole word inside \\boxed{}."
    )
    assert (results[4][2], results[4][4]["correct"], results[4][4]["parsed_action"]) == (True, True, "APPLE")


def test_hangman_word_must_be_said() -> None:
    """All letters shown do not end the game; saying the word then gives its half."""
    env = hangman()
    *_, (_, _, terminated, _, info) = [env.step(box(letter)) for letter in "aple"]
    assert not terminated
    assert info["feedback"] == "The word has E in 1 place. Say the word to win."
    assert env.step(box("apple"))[1:3] == (0.5, True)


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("P", "You have tried P before."),
        ("Angle", "You have tried ANGLE before."),
        ("apples", "Your guess has length 6, and the word has length 5."),
        ("y" * 10_000, "Your guess has length 10000, and the word has length 5."),
    ],
)
def test_hangman_invalid_answer_gives_nothing(answer: str, feedback: str) -> None:
    env = hangman()
    env.step(box("p"))
    env.step(box("angle"))
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."


@pytest.mark.parametrize("answer", ["", "4", "a,b", "é", "а", "\x00", "\ud800", "?"])
def test_hangman_other_text_is_a_format_error(answer: str) -> None:
    """The fourth but last is Cyrillic."""
    observation, reward, terminated, _, info = hangman().step(box(answer))
    assert (reward, terminated, info["correct"]) == (-0.1, True, False)
    assert "is neither a letter nor a word of the letters from A to Z. That ends the game." in observation
    assert "The word was APPLE." in observation


@pytest.mark.parametrize(("answer", "reward"), [("p", 0.2), ("z", 0.0), ("apple", 1.0), ("1", -0.1), ("ab", 0.0)])
def test_hangman_last_turn_is_rewarded_like_any_other(answer: str, reward: float) -> None:
    _, got, terminated, truncated, info = hangman(max_turns=1).step(box(answer))
    assert (got, terminated, truncated, info["correct"]) == (reward, True, False, answer == "apple")


def test_hardcore_hangman_asks_for_rare_words() -> None:
    easy, hard = HangmanEnv(7), HangmanEnv(7, hardcore=True)
    found: list[set[str]] = [set(), set()]
    for seed in range(200):
        for env, seen in zip((easy, hard), found, strict=True):
            env.reset(seed=seed)
            seen.add(env.word)
    assert len(found[0] & found[1]) < 20


def test_crossword_letters_add_up_to_one() -> None:
    env = crossword()
    answers = ("0 0 L", "0 1 a", "0 2 m", "0 3 p", "1 2 A", "2 2 p")
    results = [env.step(box(answer)) for answer in answers]
    assert [result[1] for result in results] == pytest.approx([1 / 6] * 6)
    assert [result[2] for result in results] == [False] * 5 + [True]
    observation, *_, info = results[-1]
    assert (info["correct"], info["parsed_action"]) == (True, "2 2 P")
    assert observation.startswith("P is right, and the crossword is full.\n")
    assert observation.endswith(
        "\n    0  1  2  3\n 0  L  A  M  P\n 1  .  .  A  .\n 2  .  .  P  .\nThe game is over: you won."
    )


def test_crossword_wrong_letter_gives_nothing_and_is_remembered() -> None:
    env = crossword()
    _, reward, terminated, _, info = env.step(box("0 0 X"))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, "0 0 X")
    assert info["feedback"] == "X is wrong in row 0, column 0."
    assert info["suffix"] == (
        "\nThe clues:\nacross from row 0 column 0, 4 letters: It lights up a room in the evening\n"
        "down from row 0 column 2, 3 letters: It shows where the roads and towns are\n"
        "The grid, '_' for an empty cell and '.' for none:\n"
        "    0  1  2  3\n 0  _  _  _  _\n 1  .  .  _  .\n 2  .  .  _  .\nWrong so far: 0 0 X.\n"
        "Turns left: 99. Answer like \\boxed{0 3 E}: row column letter."
    )


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("3 0 A", "That cell is outside the grid."),
        ("-1 0 A", "That cell is outside the grid."),
        (f"0 {'9' * 500} A", "That cell is outside the grid."),
        ("1 0 A", "The cell in row 1, column 0 takes no letter."),
        ("0 0 A", "The cell in row 0, column 0 is filled already."),
        ("0 1 x", "X was wrong in row 0, column 1 before."),
    ],
)
def test_crossword_invalid_answer_gives_nothing(answer: str, feedback: str) -> None:
    env = crossword()
    env.step(box("0 0 L"))
    env.step(box("0 1 X"))
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."


@pytest.mark.parametrize(
    "answer",
    [
        "",
        "0 0",
        "L 0 0",
        "0 0 LA",
        "0 0 1",
        "0 0 é",
        "0,0,L",
        "0 0 L L",
        "0.0 0 L",
        "[0 0 L]",
        "0 0 " + " " * 2_000 + "L",
    ],
)
def test_crossword_other_text_is_a_format_error(answer: str) -> None:
    observation, reward, terminated, _, info = crossword().step(box(answer))
    assert (reward, terminated, info["correct"]) == (-0.1, True, False)
    assert "is not a row, a column and a letter with spaces between them. That ends the game." in observation
    assert "The words were LAMP, MAP." in observation


@pytest.mark.parametrize(("answer", "reward"), [("0 0 L", 1 / 6), ("0 0 X", 0.0), ("9 9 X", 0.0), ("x", -0.1)])
def test_crossword_last_turn_is_rewarded_like_any_other(answer: str, reward: float) -> None:
    env = crossword(max_turns=10)
    env.turn = 9
    _, got, terminated, truncated, info = env.step(box(answer))
    assert (got, terminated, truncated, info["correct"]) == (reward, True, False, False)


def test_word_search_words_add_up_to_one() -> None:
    env = word_search()
    _, reward, terminated, _, info = env.step(box("0 0 0 3"))
    assert (reward, terminated, info["feedback"], info["parsed_action"]) == (0.5, False, "You found TREE.", "0 0 0 3")
    assert info["suffix"] == (
        "\nWords found: 1 of 2.\nWords to find: STAR.\n    0  1  2  3  4\n 0  t  r  e  e  S\n 1  E  X  X  X  T\n"
        " 2  E  X  X  X  A\n 3  R  X  X  X  R\n 4  T  X  X  X  X\n"
        "Turns left: 19. Answer like \\boxed{2 0 2 5}: row column row column."
    )
    _, reward, terminated, _, info = env.step(box("0 4 3 4"))
    assert (reward, terminated, info["correct"]) == (0.5, True, True)
    assert info["feedback"] == "You found STAR, the last of the words."


@pytest.mark.parametrize("answer", ["0 3 0 0", "4 0 1 0", "1 0 4 0", " 0  0 0 3 ", "00 0 +0 3"])
def test_word_search_takes_a_word_from_either_end_and_where_it_stands_by_chance(answer: str) -> None:
    assert word_search().step(box(answer))[1] == 0.5


def test_word_search_word_counts_once() -> None:
    env = word_search()
    env.step(box("0 0 0 3"))
    _, reward, _, _, info = env.step(box("1 0 4 0"))
    assert (reward, info["feedback"], info["parsed_action"]) == (0.0, "TREE was found before.", "1 0 4 0")


@pytest.mark.parametrize(
    ("answer", "letters"), [("0 0 0 4", "TREES"), ("2 4 0 4", "ATS"), ("1 1 1 1", "X"), ("0 2 0 0", "ERT")]
)
def test_word_search_other_letters_give_nothing(answer: str, letters: str) -> None:
    _, reward, terminated, _, info = word_search().step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, answer)
    assert info["feedback"] == f"The letters {letters} are none of the words."


@pytest.mark.parametrize(
    ("answer", "feedback"),
    [
        ("0 0 0 5", "That is outside the grid."),
        ("-1 0 0 0", "That is outside the grid."),
        (f"0 0 0 {'9' * 500}", "That is outside the grid."),
        ("0 0 3 3", "That is neither in one row nor in one column."),
        ("0 0 0 2", "You have given that answer before."),
        ("0 2 0 0", "You have given that answer before."),
    ],
)
def test_word_search_invalid_answer_gives_nothing(answer: str, feedback: str) -> None:
    env = word_search()
    env.step(box("0 0 0 2"))
    _, reward, terminated, _, info = env.step(box(answer))
    assert (reward, terminated, info["parsed_action"]) == (0.0, False, None)
    assert info["feedback"] == f"{feedback} The turn is lost."


@pytest.mark.parametrize("answer", ["", "0 0 0", "0 0 0 3 4", "TREE", "0,0,0,3", "[0 0 0 3]", "0 0 0 ３", "1 " * 5_000])
def test_word_search_other_text_is_a_format_error(answer: str) -> None:
    observation, reward, terminated, _, info = word_search().step(box(answer))
    assert (reward, terminated, info["correct"]) == (-0.1, True, False)
    assert "is not four whole numbers with spaces between them. That ends the game." in observation
    assert "The words not found were STAR, TREE." in observation


def test_word_search_last_turn_is_rewarded_like_any_other() -> None:
    env = word_search(max_turns=2)
    env.step(box("9 9 9 9"))
    observation, reward, terminated, truncated, info = env.step(box("0 0 0 3"))
    assert (reward, terminated, truncated, info["correct"]) == (0.5, True, False, False)
    assert "You have used all your turns. The words not found were STAR." in observation


def test_word_search_can_keep_its_words_to_itself() -> None:
    env = word_search(show_words=False)
    observation = env.step(box("0 0 0 3"))[0]
    assert "STAR" not in observation
    assert "Words found: 1 of 2.\n    0" in observation
    assert uncoloured(env).splitlines()[-2] == "? tree"


@pytest.mark.parametrize("response", ["", "crane", "\\boxed crane", "\\boxed{crane", "boxed{crane}"])
@pytest.mark.parametrize("make", GAMES)
def test_response_without_a_box_is_a_format_error(make: Any, response: str) -> None:
    _, reward, terminated, _, info = make().step(response)
    assert (reward, terminated) == (-0.1, True)
    assert info["feedback"].startswith("Your response has no complete \\boxed{}. That ends the game.")


@pytest.mark.parametrize("make", GAMES)
def test_format_error_may_go_on(make: Any) -> None:
    """With format_error_ends=False it costs a turn."""
    env = make(format_error_ends=False)
    _, reward, terminated, _, info = env.step("what?")
    assert (reward, terminated, info["parsed_action"]) == (-0.1, False, None)
    assert info["feedback"] == "Your response has no complete \\boxed{}. The turn is lost."
    assert f"Turns left: {env.max_turns - 1}." in info["suffix"]


def test_drawings() -> None:
    """The four drawings, as a person sees them."""
    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
    word = wordle()
    word.step(box("crate"))
    assert uncoloured(word) == f"  C R A T E\n  _ _ _ _ _\n\n{letters}\nturn 1 of 20 · playing"
    hung = hangman()
    for answer in ("p", "x", "angle"):
        hung.step(box(answer))
    assert uncoloured(hung) == f"  _ P P _ _\n\n{letters.replace('X', '·')}\nnot: ANGLE\nturn 3 of 20 · playing"
    crossed = crossword()
    crossed.step(box("0 0 L"))
    assert uncoloured(crossed) == (
        "    0  1  2  3\n 0  L  _  _  _\n 1        _   \n 2        _   \n\n"
        " 0  0 → It lights up a room in the evening (4)\n 0  2 ↓ It shows where the roads and towns are (3)\n"
        "turn 1 of 100 · playing"
    )
    search = word_search()
    search.step(box("0 0 0 3"))
    assert uncoloured(search) == (
        "    0  1  2  3  4\n 0  T  R  E  E  S\n 1  E  X  X  X  T\n 2  E  X  X  X  A\n 3  R  X  X  X  R\n"
        " 4  T  X  X  X  X\nSTAR tree\nturn 1 of 20 · playing"
    )


def test_drawings_are_coloured() -> None:
    env = wordle("EAT")
    env.step(box("tea"))
    assert str(env.render()).splitlines()[0] == "  \x1b[33mT\x1b[0m \x1b[33mE\x1b[0m \x1b[33mA\x1b[0m"


@pytest.mark.parametrize("make", GAMES)
def test_drawing_of_a_lost_game_shows_what_was_right(make: Any) -> None:
    env = make()
    env.step("what?")
    drawn = uncoloured(env).replace(" ", "")
    assert any(word in drawn for word in ("CRANE", "APPLE", "LAMP", "TREE"))
    assert "lost" in drawn


@pytest.mark.parametrize(
    ("maker", "arguments", "message"),
    [
        (WordleEnv, {"word_length": 2}, "word_length must be a whole number from 3 to 12"),
        (WordleEnv, {"max_turns": 0}, "max_turns must be a whole number from 1"),
        (WordleEnv, {"only_real_words": None}, "only_real_words must be True or False, not None"),
        (HangmanEnv, {"word_length": 16}, "word_length must be a whole number from 3 to 15"),
        (HangmanEnv, {"hardcore": 1}, "hardcore must be True or False, not 1"),
        (CrosswordsEnv, {"hardcore": "no"}, "hardcore must be True, False, or None to draw it, not 'no'"),
        (CrosswordsEnv, {"num_words": 21}, "num_words must be a whole number from 1 to 20"),
        (CrosswordsEnv, {"num_words": 4, "max_turns": 19}, "max_turns must be at least 20 for 4 words, not 19"),
        (WordSearchEnv, {"num_words": 5, "max_turns": 4}, "max_turns must be at least num_words, not 4 with 5"),
        (WordSearchEnv, {"num_words": 31}, "num_words must be a whole number from 1 to 30"),
        (WordSearchEnv, {"hardcore": 0}, "hardcore must be True, False, or None to draw it, not 0"),
        (WordSearchEnv, {"show_words": 1}, "show_words must be True or False, not 1"),
    ],
)
def test_wrong_arguments_say_what_is_allowed(maker: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(gem.GemError, match=message):
        maker(**arguments)
