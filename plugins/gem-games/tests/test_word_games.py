"""What the word games promise: their parameters, and that a solver which reads the observation wins every instance."""

from __future__ import annotations

import codecs
from itertools import product
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
from gem_games.words import is_word

# In ROT13, so that these lines can be shown to a child.
RUDE_IN_GRIDS = codecs.decode(
    "NFF GVG FRK PHZ SNT AVT CVFF CBEA SHPX FUVG PHAG PBPX QVPX FYHG GJNG JUBER ENCR ANMV", "rot13"
).split()


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


@pytest.mark.parametrize("env_id", ["game:WordSearch-v0-easy", "game:WordSearch-v0-hard"])
def test_word_search_spells_nothing_rude(env_id: str) -> None:
    """In none of eight directions, over many grids; but for what stands within one of the words to find."""
    env: Any = gem.make(env_id).unwrapped
    ways = [way for way in product((-1, 0, 1), repeat=2) if any(way)]
    for seed in range(100):
        env.reset(seed=seed)
        letters = {(row, column): letter for row, line in enumerate(env.grid) for column, letter in enumerate(line)}
        for (row, column), (down, right) in product(letters, ways):
            text = "".join(letters.get((row + down * step, column + right * step), " ") for step in range(6))
            for rude in filter(text.startswith, RUDE_IN_GRIDS):
                assert any(rude in word or rude[::-1] in word for word in env.words), (seed, rude)


@pytest.mark.parametrize("env_id", [f"game:Hangman-v0-{level}" for level in ("easy", "hard", "random")])
def test_hangman_can_be_won(env_id: str, many: int) -> None:
    """Asking for the letters that a word has, and then saying it, takes few enough turns."""
    env: Any = gem.make(env_id)
    for seed in range(many):
        env.reset(seed=seed)
        word = env.unwrapped.word
        results = [env.step(f"\\boxed{{{answer}}}") for answer in [*dict.fromkeys(word), word]]
        assert results[-1][4]["correct"]
        assert sum(result[1] for result in results) == pytest.approx(1.0)


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
    assert not set(known) & set(clues(not hard).of)


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


@given(st.text("ABC", min_size=5, max_size=5), st.text("ABC", min_size=5, max_size=5))
def test_marks_count_each_letter_of_the_word_once(guess: str, word: str) -> None:
    """G where the letters are the same; G and Y of a letter together as often as both words have it."""
    marks = marks_of(guess, word)
    assert [mark == "G" for mark in marks] == [letter == right for letter, right in zip(guess, word, strict=True)]
    for letter in set(guess):
        coloured = sum(mark != "X" for each, mark in zip(guess, marks, strict=True) if each == letter)
        assert coloured == min(guess.count(letter), word.count(letter))


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
