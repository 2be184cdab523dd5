"""The lists of words: what is in them, what is not, and when they are read."""

from __future__ import annotations

import codecs

import pytest

from gem_games.words import LENGTHS, is_word, nouns, word_list, words

# Written in ROT13, so that these lines can be shown to a child as well.
RUDE_LETTERS = codecs.decode(
    "fuvg shpx phag avtt ovgpu jube fyhg cravf intva znfgheo sntt cbea encvfg betnf frkhny onfgneq jnax cebfgvghg "
    "crqbcu rebgvp znfbpuvf crqrenf chqraq arpebcuvy pyvgbe iblrhe fphzont fyrnm fpuzhpx fcrezvpvq",
    "rot13",
)
RUDE_WORDS = codecs.decode(
    "nff nefr gvg gvgf pbpx qvpx cvff encr encrq ahqr anxrq frk frkl penc qnza urebva pbpnvar anmv xvxr fcvp tbbx qntb "
    "pbba arteb zheqre fhvpvqr tvg tvgf fbq qbkl ohfgl cvaxb yvzrl ubggvr uvpxrl ynovn travgnyf travgnyvn tebcvat "
    "fcnaxvat qrsybjre guerrfbzr nqhygrel pneany fnqvfg ylapuvat fulfgre cunyyv ihyiny irarerny frkgvat orurnqvat "
    "qrpncvgngrq zhgvyngvba fgenatyvat",
    "rot13",
)
GRIM_WORDS = codecs.decode("xvyy tha qeht qrnq oybbq obzo qehax uryy gbegher greebe fynir creirefr", "rot13")


@pytest.mark.parametrize("length", LENGTHS)
def test_lists_are_sorted_words_of_their_length(length: int) -> None:
    """Lower case, a to z, no word twice; the nouns are common words, and these are among all."""
    listed = word_list(length)
    for group in listed[:3]:
        assert list(group) == sorted(set(group))
        assert all(len(word) == length and word.isascii() and word.isalpha() and word.islower() for word in group)
    assert set(listed.nouns) <= set(listed.common) <= set(listed.every) == listed.known


@pytest.mark.parametrize(("length", "common", "every"), [(3, 200, 700), (4, 800, 3_000), (5, 1_200, 6_000)])
def test_lists_are_long_enough_for_games(length: int, common: int, every: int) -> None:
    assert len(words(length)) >= common
    assert len(word_list(length).every) >= every


def test_words_of_every_length() -> None:
    assert list(words()) == sorted(word for length in LENGTHS for word in words(length))
    assert list(nouns()) == sorted(word for length in LENGTHS for word in nouns(length))
    assert len(words()) > 10_000
    assert {"apple", "house"} <= set(nouns(5)) <= set(nouns())
    assert "quickly" not in nouns()


@pytest.mark.parametrize("text", ["apple", "APPLE", "Colour", "color", "zygotes", "it"])
def test_words_are_known_in_any_case(text: str) -> None:
    assert is_word(text)


@pytest.mark.parametrize(
    "text", ["", "a b", "aplpe", "qqqqq", "apple ", "\ud800\ud800\ud800", "ａｐｐｌｅ", "x" * 10**7]
)
def test_other_texts_are_no_words(text: str) -> None:
    assert not is_word(text)


def test_no_word_is_rude() -> None:
    """Neither an answer nor a guess; what is grim is no answer."""
    every = {word for length in LENGTHS for word in word_list(length).every}
    assert [word for word in every if any(stem in word for stem in RUDE_LETTERS.split())] == []
    assert every & set(RUDE_WORDS.split()) == set()
    assert set(words()) & set(GRIM_WORDS.split()) == set()
