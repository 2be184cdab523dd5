"""Whatever the gold answer is: written again it is right, another answer is wrong, and neither is an error."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_math import grade

# As in MATH, OlympiadBench, Minerva, DeepMath, Omni-MATH and college mathematics, with their slips.
LINES = (Path(__file__).parent / "golds.txt").read_text(encoding="utf-8").strip().split("\n\n")
CORES, AROUND, WHOLE = map(str.splitlines, LINES)
GOLDS = [around.replace("#", core) for around in AROUND for core in CORES] + [*WHOLE, "x" * 5000, "1," * 300 + "1"]


@pytest.mark.parametrize("part", range(4))
def test_a_gold_answer_is_right_and_another_answer_wrong(part: int) -> None:
    """Of every kind, well formed or not; as the whole response, and in a box."""
    failed = []
    for gold in GOLDS[part::4]:
        verdicts = [grade(text, gold, timeout_s=5).correct for text in (gold, rf"\boxed{{{gold}}}")]
        wrong = [grade(text, gold, timeout_s=5).correct for text in (r"\boxed{987654321}", r"\boxed{\text{no such}}")]
        if verdicts != [True, True] or wrong != [False, False]:
            failed.append((gold, verdicts, wrong))
    assert failed == []


@given(st.text(alphabet=r"\{}()[]$^_&=<>.,;:|/ 12xyabmodtext", min_size=1, max_size=20).filter(str.strip))
def test_any_text_may_be_a_gold_answer(gold: str) -> None:
    """It is right as it stands, and compared with an answer without an error."""
    assert grade(gold, gold, timeout_s=5).correct
    assert isinstance(grade(r"\boxed{6}", gold, timeout_s=5).correct, bool)


@pytest.mark.parametrize(
    ("gold", "right", "wrong"),
    [
        (r"\frac{1}{2", [r"\frac{1}{2}", r" \frac{1}{2 } "], [r"\frac{1}{3}", "0.5", ""]),
        (r"\sqrt{2", [r"\sqrt{2}"], ["2"]),
        (r"{1", ["1", "{1}"], ["2", "11"]),
        (r"\text{yes}}", ["Yes", r"\text{yes}"], ["no"]),
        ("{", [], ["", "1"]),
    ],
)
def test_braces_do_not_count_in_a_gold_answer_that_cannot_be_read(
    gold: str, right: list[str], wrong: list[str]
) -> None:
    """So that a slip in the data does not make right answers wrong; the rest is compared sign by sign."""
    assert [text for text in right if not grade(rf"So \boxed{{{text}}}.", gold).correct] == []
    assert [text for text in wrong if grade(rf"So \boxed{{{text}}}.", gold).correct] == []


def test_a_number_takes_no_part_in_what_cannot_be_compared() -> None:
    """The reason names why there is only the text to go by."""
    found = grade(r"\boxed{\frac{x}{y}}", r"x \star \oint \mathfrak{g}", timeout_s=20)
    assert not found.correct
    assert found.reason.startswith("it is not written like the reference, and cannot be compared otherwise: ")
