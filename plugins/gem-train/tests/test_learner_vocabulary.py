"""The learner's vocabulary."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_train.learner.vocabulary import END, UNKNOWN, Vocabulary

SEEN = [
    "Guess a number from 1 to 50.\nWrite it inside \\boxed{}.",
    "It is higher than 25.\nGuess again.",
    "é 25 \\boxed{7} a b",
] * 3
VOCABULARY = Vocabulary.build(SEEN)
PIECES = st.sampled_from([*VOCABULARY.words, *SEEN])


@given(st.lists(st.one_of(PIECES, st.text(string.printable + "é"))).map("".join))
def test_what_is_encoded_is_decoded_to_the_letter(text: str):
    """With phrases as single tokens or without, whatever stands beside them."""
    for phrases in (True, False):
        ids = VOCABULARY.encode(text, phrases=phrases)
        assert VOCABULARY.decode(ids) == text
        assert all(END < index < len(VOCABULARY) for index in ids)


def test_a_character_that_was_never_seen_is_unknown():
    """It is one token, and so is a response that a player never gave shown as what it is."""
    assert VOCABULARY.encode("语") == [UNKNOWN]
    assert VOCABULARY.decode([UNKNOWN]) == "\N{REPLACEMENT CHARACTER}"


def test_numbers_and_sentences_are_single_tokens():
    """A number wherever it stands, so that an environment's 25 is a player's 25; and what is always the same."""
    (number,) = VOCABULARY.encode("25")
    assert number in VOCABULARY.encode("It is higher than 25.")
    assert number in VOCABULARY.encode("\\boxed{25}")
    assert len(VOCABULARY.encode("Guess again.")) == 1
    assert len(VOCABULARY.encode("Guess again.", phrases=False)) > 1


@pytest.mark.parametrize("text", ["a" * 100_000, "a " * 50_000, "ab" * 50_000, ", " * 50_000, "a.b" * 40_000])
def test_hostile_text_is_read_in_linear_time(text: str) -> None:
    """A model may print anything through a tool."""
    vocabulary = Vocabulary.build([text])
    assert vocabulary.decode(vocabulary.encode(text)) == text
