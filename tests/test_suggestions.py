"""The nearest names of an error message."""

from __future__ import annotations

import pytest

from gem_core.suggestions import did_you_mean, nearest

NAMES = ["math:GSM8K", "math:MATH500", "game:Mastermind-v0", "game:Minesweeper-v0"]


def test_case_does_not_count() -> None:
    """A name in the wrong case is found, in its own case."""
    assert nearest("MATH:gsm8k", NAMES)[0] == "math:GSM8K"


def test_at_most_the_limit_is_named() -> None:
    """No more than three names are given."""
    assert len(nearest("name", [f"name{i}" for i in range(9)])) == 3


@pytest.mark.parametrize(
    ("wrong", "names", "text"),
    [
        ("concta", ["concat"], " Did you mean 'concat'?"),
        ("conca", ["concat", "concats"], " Did you mean 'concat' or 'concats'?"),
        ("name", ["name1", "name2", "name3"], " Did you mean 'name3', 'name2' or 'name1'?"),
        ("zzz", ["concat"], ""),
        ("", ["concat"], ""),
        ("concat", [], ""),
    ],
)
def test_question_reads_as_a_sentence(wrong: str, names: list[str], text: str) -> None:
    """Names are joined as in a sentence; without a near one there is no question."""
    assert did_you_mean(wrong, names) == text


def test_megabytes_of_a_name_finish() -> None:
    """A hostile name is compared by its beginning alone."""
    assert nearest("concat" * 1_000_000, ["concat"]) == []
