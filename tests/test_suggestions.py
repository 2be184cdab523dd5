"""The nearest names of an error message."""

from __future__ import annotations

import pytest

from gem_core.suggestions import did_you_mean, nearest


@pytest.mark.parametrize(
    ("wrong", "names", "text"),
    [
        ("CONCTA", ["concat"], " Did you mean 'concat'?"),
        ("conca", ["concat", "concats"], " Did you mean 'concat' or 'concats'?"),
        ("name", ["name1", "name2", "name3", "name0"], " Did you mean 'name3', 'name2' or 'name1'?"),
        ("zzz", ["concat"], ""),
        ("", ["concat"], ""),
        ("concat", [], ""),
    ],
)
def test_question_reads_as_a_sentence(wrong: str, names: list[str], text: str) -> None:
    """At most three names, whatever their case; without a near one there is no question."""
    assert did_you_mean(wrong, names) == text


def test_megabytes_of_a_name_finish() -> None:
    """A hostile name is compared by its beginning alone."""
    assert nearest("concat" * 1_000_000, ["concat"]) == []
