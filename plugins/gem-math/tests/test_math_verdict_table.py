"""The verdicts of ``verdicts.txt``, and what was found beside them: one test each, that names every line that fails."""

import time
from pathlib import Path

import pytest

from gem_core.errors import GradingError
from gem_math import grade
from gem_math.grading import extract_answer

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


@pytest.mark.parametrize("part", range(8))
def test_verdicts_of_the_table(part):
    """Each line has its verdict; the failing ones are named, a part of the table to a test."""
    found = [(line, *verdict(line)) for line in LINES[part::8]]
    assert [(line, got) for line, expected, got in found if got != expected] == []


def test_the_table_is_whole():
    """No line is lost on the way, and right and wrong are both there."""
    assert len(LINES) == len(set(LINES)) >= 790
    assert {line[-1] for line in LINES} == {"Y", "N"}
    assert min(sum(line.endswith(end) for line in LINES) for end in "YN") > 300


@pytest.mark.parametrize("opening", [r"\(", r"\[", "$", "$$"])
def test_marks_that_open_mathematics_take_no_time(opening):
    """Marks that open mathematics and never close it are read once each, not once for each pair."""
    text = opening * 200_000
    started = time.thread_time()
    extract_answer(text)
    # Once for each pair took seconds; the limit is far from both.
    assert time.thread_time() - started < 0.7
