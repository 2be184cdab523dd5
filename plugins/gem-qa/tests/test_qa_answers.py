"""Normalisation, exact match, token F1, and the forms in which rows give their accepted answers."""

from __future__ import annotations

import json
import re
import string
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.errors import GradingError
from gem_qa.answers import accepted_answers, exact_match, normalized, token_f1, unwrapped


def by_the_paper(text: str) -> str:
    """The rule of SQuAD for ASCII, said in another way."""
    kept = "".join(letter for letter in text.lower() if letter not in set(string.punctuation))
    return " ".join(re.split(r"\s+", re.sub(r"\b(?:an|a|the)\b", " ", kept).strip()))


@given(st.text(alphabet=st.characters(max_codepoint=127)))
def test_ascii_is_normalised_as_in_squad(text: str) -> None:
    """Unless nothing would be left, where SQuAD has every such answer equal to every other."""
    assert by_the_paper(text) in (normalized(text), "")


@given(st.text(max_size=30))
def test_every_text_equals_itself_in_another_dress(text: str) -> None:
    """Full stops, brackets and spaces around it, and capital letters, whatever the script."""
    if normalized(text):
        assert exact_match(text, [text])
        assert token_f1(text, [text]) == pytest.approx(1.0)
    words = re.findall(r"[^\W\d_]+", text)
    if words:
        plain = " ".join(words)
        assert exact_match(f"  ({plain}). ", [plain])


@pytest.mark.parametrize(
    ("answer", "gold"),
    [
        ("the Eiffel Tower", "Eiffel tower."),
        ("“Hamlet”", "Hamlet"),
        ("Giant’s Causeway", "Giant's Causeway"),
        ("ＮＡＳＡ", "NASA"),
        ("Straße", "STRASSE"),
        ("Dvor\u030ca\u0301k", "Dvořák"),
        ("−269", "-269"),
        ("U.S.A.", "USA"),
        ("4,478", "4478"),
        ("a\u00a0\u2003b c", "b c"),
        ("Par\u200bis", "Paris"),
        ("\u200eCairo\u200f", "Cairo"),
        ("a\x1cb", "b"),
        ("!!!", "!!!"),
    ],
)
def test_differences_of_form_do_not_matter(answer: str, gold: str) -> None:
    """Case, punctuation, articles, white space and the ways to encode a letter, in any script."""
    assert exact_match(answer, [gold])


@pytest.mark.parametrize(
    ("answer", "gold"),
    [
        ("", "the"),
        ("!", "?"),
        ("a", "the"),
        ("Paris", "London"),
        ("Dvorak", "Dvořák"),
        ("theatre", "atre"),
    ],
)
def test_differences_of_content_do_matter(answer: str, gold: str) -> None:
    """What is left of no word is no wild card; accents are letters."""
    assert not exact_match(answer, [gold])


@pytest.mark.parametrize(
    ("answer", "gold", "f1"),
    [
        ("Georg von Knobelsdorff", "Georg Wenzeslaus von Knobelsdorff", 6 / 7),
        ("the cat", "cat", 1.0),
        ("cat cat cat", "cat", 0.5),
        ("dog", "cat", 0.0),
        ("", "cat", 0.0),
    ],
)
def test_token_f1_counts_words(answer: str, gold: str, f1: float) -> None:
    """Each word as often as it stands on both sides."""
    assert token_f1(answer, [gold]) == pytest.approx(f1)


@given(st.text(max_size=40), st.lists(st.text(max_size=40), max_size=3))
def test_scores_agree_and_keep_their_bounds(answer: str, accepted: list[str]) -> None:
    """An exact match has an F1 of 1, and F1 is symmetric between one answer and one accepted one."""
    f1 = token_f1(answer, accepted)
    assert 0.0 <= f1 <= 1.0
    assert not exact_match(answer, accepted) or f1 == pytest.approx(1.0)
    assert f1 == pytest.approx(max((token_f1(text, [answer]) for text in accepted), default=0.0))


@pytest.mark.parametrize(
    ("value", "accepted"),
    [
        ("Paris", ["Paris"]),
        (("Paris", "Paris"), ["Paris"]),
        (np.array(["a", "b"]), ["a", "b"]),
        ('["Paris", "City of Light"]', ["Paris", "City of Light"]),
        ("['Paris', \"Hawai'i\"]", ["Paris", "Hawai'i"]),
        (str(np.array(["Paris", "City of Light"])), ["Paris", "City of Light"]),
        ("['O\\'Neil', 12]", ["O'Neil", "12"]),
        ("[Deutsch]", ["[Deutsch]"]),
        ("[]", None),
        ("['']", None),
        ("  ", None),
        (None, None),
        ([None, "x"], ["x"]),
        (True, ["True"]),
        (1971, ["1971"]),
        ({"text": ["Denver Broncos"], "answer_start": [177]}, ["Denver Broncos"]),
        ({"value": "Sinclair Lewis", "aliases": ["Lewis"], "type": "x"}, ["Sinclair Lewis", "Lewis"]),
        ({"other": 1}, None),
        (object(), None),
    ],
)
def test_accepted_answers_in_every_form(value: Any, accepted: list[str] | None) -> None:
    """Where there is none, there is no verdict, and no reward of 0."""
    if accepted is None:
        with pytest.raises(GradingError, match="accepted answer"):
            accepted_answers(value)
    else:
        assert accepted_answers(value) == accepted


@given(st.lists(st.text(max_size=20), min_size=1, max_size=4), st.sampled_from([json.dumps, repr, list]))
def test_lists_written_as_text_come_back(texts: list[str], write: Any) -> None:
    """By JSON or by Python."""
    expected = [text for text in dict.fromkeys(texts) if text.strip()]
    if expected:
        assert accepted_answers(write(texts)) == expected


def test_hostile_lists_are_texts() -> None:
    """Nothing is run, and nothing takes long."""
    for text in ("[__import__('os').system('x')]", "[" * 100_000 + "]" * 100_000, "['" + "a" * 1_000_000 + "]"):
        assert accepted_answers(text) == [text]
    nested: list[Any] = []
    for _ in range(100_000):
        nested = [nested]
    with pytest.raises(GradingError, match="nested too deeply"):
        accepted_answers(nested)


@pytest.mark.parametrize(
    ("answer", "bare"),
    [
        ("\\boxed{\\text{ Paris }}", "Paris"),
        ("$\\mathrm{Paris}$", "Paris"),
        ("$$1971$$", "1971"),
        ("\\(\\textbf{a} and \\textbf{b}\\)", "\\textbf{a} and \\textbf{b}"),
        ("\\text{a{b}c}", "a{b}c"),
        ("$5", "$5"),
        ("\\text", "\\text"),
        ("\\text{}", ""),
        ("Paris", "Paris"),
    ],
)
def test_latex_around_the_whole_answer_is_taken_off(answer: str, bare: str) -> None:
    """And none that is part of it."""
    assert unwrapped(answer) == bare


def test_hostile_latex_takes_time_in_proportion() -> None:
    """Megabytes of openings, closings and spaces."""
    for text in (
        "$" * 1_000_000 + "x",
        "\\text{" * 200_000,
        "\\text{" * 200_000 + "}" * 200_000,
        "\\text" + " " * 1_000_000,
    ):
        assert len(unwrapped(text)) <= len(text)
