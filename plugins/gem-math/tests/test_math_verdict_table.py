"""The verdicts of ``verdicts.txt``, and what was found beside them: one test each, that names every line that fails."""

from pathlib import Path

import pytest

from gem_core.errors import GradingError
from gem_math import grade
from gem_math.grading.extraction import formula_spans

LINES = [
    line
    for line in (Path(__file__).parent / "verdicts.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
]


def verdict(line):
    """Grade a line; return the verdict that it expects and the one it gets."""
    gold, answer, expected = line.split(" ||| ")
    response = answer[1:] if answer.startswith("!") else rf"\boxed{{{answer}}}"
    try:
        return expected, "Y" if grade(response, gold, timeout_s=10).correct else "N"
    except GradingError as error:
        return expected, str(error)


@pytest.mark.few(2)
@pytest.mark.parametrize("part", range(8))
def test_verdicts_of_the_table(part):
    """Each line has its verdict; the failing ones are named, a part of the table to a test."""
    found = [(line, *verdict(line)) for line in LINES[part::8]]
    assert [(line, got) for line, expected, got in found if got != expected] == []


def test_the_table_is_whole():
    """No line is lost on the way, and right and wrong are both there."""
    assert len(LINES) == len(set(LINES)) == 3140
    assert {line[-1] for line in LINES} == {"Y", "N"}
    assert min(sum(line.endswith(end) for line in LINES) for end in "YN") > 300


@pytest.mark.parametrize(
    ("text", "spans"),
    [
        ("$a$$b$", ["$a$", "$b$"]),
        ("$$x$$ and $y$", ["$$x$$", "$y$"]),
        (r"\[ unclosed $3$ \(4\)", ["$3$", r"\(4\)"]),
        (r"\( unclosed \[3\]", [r"\[3\]"]),
        ("\\( a \n b \\) $c$", ["$c$"]),
        ("\\[ a \n b \\] $c$", ["\\[ a \n b \\]", "$c$"]),
        (r"\$5 and $6$", ["$6$"]),
        ("$5 \n and $6$", ["$6$"]),
        ("$$ $ 7 $", ["$ 7 $"]),
        ("$$$$", []),
        ("", []),
    ],
)
def test_formulas_between_marks_are_found(text, spans):
    """Each kind of mark closes its own kind, and one that is never closed hides nothing behind it."""
    assert [text[start:end] for start, end in formula_spans(text)] == spans
