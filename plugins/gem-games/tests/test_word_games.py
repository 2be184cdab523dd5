"""What the word games promise: their parameters, and that a solver which reads the observation wins every instance."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_games.cheap_random import CheapRandom
from gem_games.clean_letters import fill
from gem_games.crossword_layout import lay_out
from gem_games.crosswords import clues
from gem_games.wordle import marks_of
from gem_games.words import is_word, words

PARAMETERS: dict[str, dict[str, Any]] = {
    "game:Wordle-v0-easy": {"word_length": 3, "only_real_words": True, "max_turns": 15},
    "game:Wordle-v0-hard": {"word_length": 5, "only_real_words": True, "max_turns": 25},
    "game:Wordle-v0-random": {"word_length": None, "only_real_words": True, "max_turns": None},
    "game:Hangman-v0-easy": {"word_length": 3, "hardcore": False, "max_turns": 10},
    "game:Hangman-v0-hard": {"word_length": 7, "hardcore": False, "max_turns": 20},
    "game:Hangman-v0-random": {"word_length": None, "hardcore": False, "max_turns": None},
    "game:Crosswords-v0-easy": {"hardcore": False, "max_turns": 30, "num_words": 3},
    "game:Crosswords-v0-hard": {"hardcore": True, "max_turns": 40, "num_words": 3},
    "game:Crosswords-v0-random": {"hardcore": None, "max_turns": None, "num_words": None},
    "game:WordSearch-v0-easy": {"hardcore": False, "max_turns": 20, "num_words": 5},
    "game:WordSearch-v0-hard": {"hardcore": True, "max_turns": 20, "num_words": 5},
    "game:WordSearch-v0-random": {"hardcore": None, "max_turns": None, "num_words": None},
}
IDS = list(PARAMETERS)
ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
# In ROT13, so that these lines can be shown to a child.
RUDE_IN_GRIDS = codecs.decode(
    "NFF GVG FRK PHZ SNT AVT CVFF CBEA SHPX FUVG PHAG PBPX QVPX FYHG GJNG JUBER ENCR ANMV", "rot13"
).split()


def box(answer: object) -> str:
    return f"\\boxed{{{answer}}}"


class WordleSolver:
    """Guesses the first common word that agrees with all marks that the observation shows."""

    def __call__(self, observation: str) -> str:
        length = int(re.findall(r"The word has (\d+) letters", observation)[-1])
        marked = re.findall(r"^([A-Z]+):((?: [GYX])+)$", observation, re.MULTILINE)
        if not marked:
            self.left = [word.upper() for word in words(length)]
        else:
            guess, marks = marked[-1][0], marked[-1][1].split()
            self.left = [word for word in self.left if word != guess and marks_of(guess, word) == marks]
        return box(self.left[0])


def crossword_solver(observation: str) -> str:
    """Look the clues up in the lists they come from, and fill in the first letter that is missing."""
    known = {clue: word for hard in (False, True) for word, clue in clues(hard).of.items()}
    rows = [row.split()[1:] for row in re.findall(r"^ ?\d+(?:  \S)+$", observation, re.MULTILINE)]
    listed = re.findall(r"^(across|down) from row (\d+) column (\d+), (\d+) letters: (.+)$", observation, re.MULTILINE)
    for direction, row, column, length, clue in listed:
        word = known[clue]
        assert len(word) == int(length)
        for place, letter in enumerate(word):
            at = int(row) + place * (direction == "down"), int(column) + place * (direction == "across")
            if rows[at[0]][at[1]] == "_":
                return box(f"{at[0]} {at[1]} {letter.lower()}")
    raise AssertionError("no cell is empty")


def word_search_solver(observation: str) -> str:
    """Scan rows and columns for the first word that is still to be found."""
    word = re.findall(r"Words to find: ([A-Z]+)", observation)[-1]
    rows = [row.split()[1:] for row in re.findall(r"^ ?\d+(?:  [A-Za-z])+$", observation, re.MULTILINE)]
    grid = ["".join(row).upper() for row in rows]
    for row, letters in enumerate(grid):
        if word in letters:
            column = letters.index(word)
            return box(f"{row} {column} {row} {column + len(word) - 1}")
    for column, down in enumerate(map("".join, zip(*grid, strict=True))):
        if word in down:
            row = down.index(word)
            return box(f"{row} {column} {row + len(word) - 1} {column}")
    raise AssertionError(f"{word} is not in the grid")


def solver(env_id: str) -> Callable[[str], str]:
    game = env_id.removeprefix("game:").partition("-")[0]
    if game == "Wordle":
        return WordleSolver()
    return crossword_solver if game == "Crosswords" else word_search_solver


def played(env: Any, seed: int, agent: Any = None) -> list[Any]:
    """Play an episode and return all that it gave."""
    observation, info = env.reset(seed=seed)
    records: list[Any] = [(observation, info)]
    over = False
    while not over:
        result = env.step(agent(observation) if agent else env.sample_random_action())
        observation, over = result[0], result[2]
        records.append(result)
    return records


def test_registered_ids_and_parameters() -> None:
    """Every id has the parameters that published baselines were measured with."""
    assert {env_id: dict(gem.spec(env_id).kwargs) for env_id in IDS} == PARAMETERS


@pytest.mark.parametrize("env_id", [env_id for env_id in IDS if "Hangman" not in env_id])
def test_solver_wins_many_games(env_id: str, many: int) -> None:
    """Every instance is solvable within its turns, from the observations alone; the rewards add up to 1."""
    env, agent = gem.make(env_id), solver(env_id)
    for seed in range(many):
        records = played(env, seed, agent)
        assert records[-1][4]["correct"], f"seed {seed}: {records[-1][0]}"
        assert sum(record[1] for record in records[1:]) == pytest.approx(1.0)


@pytest.mark.parametrize("env_id", [env_id for env_id in IDS if "Hangman" in env_id])
def test_hangman_can_be_won(env_id: str, many: int) -> None:
    """Asking for the letters that a word has, and then saying it, takes few enough turns."""
    env: Any = gem.make(env_id)
    for seed in range(many):
        env.reset(seed=seed)
        word = env.unwrapped.word
        results = [env.step(box(answer)) for answer in [*dict.fromkeys(word), word]]
        assert results[-1][4]["correct"]
        assert sum(result[1] for result in results) == pytest.approx(1.0)


def test_random_sizes() -> None:
    wordle, hangman = gem.make("game:Wordle-v0-random"), gem.make("game:Hangman-v0-random")
    sizes: list[set[tuple[int, int]]] = [set(), set()]
    for seed in range(100):
        for env, found in zip((wordle, hangman), sizes, strict=True):
            env.reset(seed=seed)
            game: Any = env.unwrapped
            found.add((game.word_length, game.max_turns))
            assert len(game.word) == game.word_length
    assert sizes == [{(3, 15), (4, 20), (5, 25)}, {(3, 10), (5, 15), (7, 20)}]


@pytest.mark.parametrize("name", ["Crosswords", "WordSearch"])
def test_random_difficulty(name: str) -> None:
    """Easy and hard turn up, with 20 turns."""
    env: Any = gem.make(f"game:{name}-v0-random")
    levels = {(env.reset(seed=seed), env.unwrapped.hardcore, env.unwrapped.max_turns)[1:] for seed in range(50)}
    assert levels == {(False, 20), (True, 20)}


@pytest.mark.parametrize("hard", [False, True])
@pytest.mark.parametrize(("count", "cells"), [(1, 5), (3, 15), (3, 20), (5, 100), (20, 100)])
def test_layouts_are_crosswords(hard: bool, count: int, cells: int) -> None:
    """Each run of letters, across or down, is one of the words; all are connected; and there are cells enough."""
    for seed in range(50):
        placed = lay_out(clues(hard).words, count, cells, CheapRandom(seed))
        letters: dict[tuple[int, int], str] = {}
        for row, column, across, word in placed:
            for place, letter in enumerate(word):
                cell = (row, column + place) if across else (row + place, column)
                assert letters.setdefault(cell, letter) == letter
        assert len(letters) <= cells
        assert len({each.word for each in placed}) == count
        assert min(row for row, _ in letters) == min(column for _, column in letters) == 0
        assert sorted(runs(letters)) == sorted(each.word for each in placed)
        assert connected(set(letters))


def runs(letters: dict[tuple[int, int], str]) -> list[str]:
    """Return all words of two letters or more that can be read across or down."""
    found = []
    for down, right in ((0, 1), (1, 0)):
        for row, column in letters:
            if (row - down, column - right) not in letters:
                word, at = "", (row, column)
                while at in letters:
                    word, at = word + letters[at], (at[0] + down, at[1] + right)
                if len(word) > 1:
                    found.append(word)
    return found


def connected(cells: set[tuple[int, int]]) -> bool:
    seen, edge = set(), [next(iter(cells))]
    while edge:
        row, column = edge.pop()
        seen.add((row, column))
        beside = {(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)}
        edge += (beside & cells) - seen
    return seen == cells


@pytest.mark.parametrize("hard", [False, True])
def test_clues(hard: bool) -> None:
    """Some hundred words each, every one with a short clue that does not give it away."""
    known = clues(hard).of
    assert len(known) >= 250
    assert len(set(known.values())) == len(known)
    for word, clue in known.items():
        assert is_word(word)
        assert word.lower() not in clue.lower()
        assert 3 <= len(word) <= 10
        assert 4 <= len(clue) <= 70
        assert not clue.endswith(".")
    assert sum(len(word) <= 5 for word in known) >= 60


def test_easy_and_hard_clues_share_no_word() -> None:
    assert set(clues(False).of) & set(clues(True).of) == set()


@pytest.mark.parametrize(("num_words", "hardcore"), [(1, False), (5, True), (30, False), (30, True)])
def test_word_search_hides_all_words(num_words: int, hardcore: bool) -> None:
    """However many there are: each stands in the grid, across or down."""
    env: Any = gem.make("game:WordSearch-v0-easy", num_words=num_words, hardcore=hardcore, max_turns=30).unwrapped
    for seed in range(30):
        env.reset(seed=seed)
        lines = " ".join([*env.grid, *map("".join, zip(*env.grid, strict=True))])
        assert len(set(env.words)) == num_words
        assert all(word in lines for word in env.words)
        assert not any(word[::-1] in env.words and word != word[::-1] for word in env.words)


@pytest.mark.parametrize(
    ("env_id", "kwargs"),
    [
        ("game:Hangman-v0-easy", {"max_turns": 10_000}),
        ("game:Crosswords-v0-easy", {"max_turns": 10_000, "num_words": 1}),
        ("game:Wordle-v0-easy", {"max_turns": 10_000}),
        ("game:WordSearch-v0-easy", {"max_turns": 10_000, "num_words": 1}),
    ],
)
def test_random_actions_exhaust_a_game(env_id: str, kwargs: dict[str, Any]) -> None:
    """Actions never repeat what is known to be wrong, so that a random agent with turns enough wins."""
    env = gem.make(env_id, **kwargs)
    assert all(played(env, seed)[-1][4]["correct"] for seed in range(3))


@given(st.text("ABC", min_size=5, max_size=5), st.text("ABC", min_size=5, max_size=5))
def test_marks_count_each_letter_of_the_word_once(guess: str, word: str) -> None:
    """G where the letters are the same; G and Y of a letter together as often as both words have it."""
    marks = marks_of(guess, word)
    assert [mark == "G" for mark in marks] == [letter == right for letter, right in zip(guess, word, strict=True)]
    for letter in set(guess):
        coloured = sum(mark != "X" for each, mark in zip(guess, marks, strict=True) if each == letter)
        assert coloured == min(guess.count(letter), word.count(letter))


def eight_directions(size: int) -> list[list[tuple[int, int]]]:
    """Return every row, column and diagonal of a square, from both ends."""
    cells = [(row, column) for row in range(size) for column in range(size)]
    groups: dict[tuple[str, int], list[tuple[int, int]]] = {}
    for row, column in cells:
        for kind, number in (("row", row), ("column", column), ("falling", row - column), ("rising", row + column)):
            groups.setdefault((kind, number), []).append((row, column))
    return [way for line in groups.values() for way in (line, line[::-1])]


@pytest.mark.parametrize("env_id", ["game:WordSearch-v0-easy", "game:WordSearch-v0-hard"])
def test_word_search_spells_nothing_rude(env_id: str) -> None:
    """In none of eight directions, over 500 grids; but for what stands within one of the words to find."""
    env: Any = gem.make(env_id).unwrapped
    directions: dict[int, list[list[tuple[int, int]]]] = {}
    for seed in range(500):
        env.reset(seed=seed)
        size = len(env.grid)
        for line in directions.setdefault(size, eight_directions(size)):
            text = "".join(env.grid[row][column] for row, column in line)
            for rude in RUDE_IN_GRIDS:
                if rude in text:
                    assert any(rude in word or rude[::-1] in word for word in env.words), (seed, rude)


def test_words_that_are_rude_side_by_side_are_placed_anew() -> None:
    """Their own letters stay; what a free cell would complete gets another letter; what is within one word stands."""
    letters, rude = b"A" * 36, RUDE_IN_GRIDS[1]
    halves = [{0: rude[0], 1: rude[1]}, {2: rude[2], 3: "E"}]
    assert fill(halves, letters, 6, CheapRandom(1)) is None
    whole = fill([dict(enumerate(rude))], letters, 6, CheapRandom(1))
    assert whole is not None
    assert whole.startswith(rude)
    mended = fill([{0: rude[0], 1: rude[1]}], rude.encode() + b"A" * 33, 6, CheapRandom(1))
    assert mended is not None
    assert mended[:2] == rude[:2]
    assert not mended.startswith(rude)
