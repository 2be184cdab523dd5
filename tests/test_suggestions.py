"""The nearest names of an error message."""

from __future__ import annotations

import pytest

from gem_core.suggestions import did_you_mean


@pytest.mark.parametrize(
    ("wrong", "names", "text"),
    [
        ("CONCTA", ["concat"], " Did you mean 'concat'?"),
        ("name", ["name1", "name2", "name3", "name0"], " Did you mean 'name3', 'name2' or 'name1'?"),
        ("zzz", ["concat"], ""),
        ("concat" * 1_000_000, ["concat"], ""),
    ],
)
def test_question_reads_as_a_sentence(wrong: str, names: list[str], text: str) -> None:
    """At most three names, whatever their case; a hostile one is compared by its beginning alone."""
    assert did_you_mean(wrong, names) == text
