"""Formulas among words: no sign, bracket or mark of theirs is lost, and none makes a right answer wrong."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from gem_math import grade

SENTENCES = [
    "slope is $#$", r"\text{slope is }#", r"\text{the line } # \text{ is tangent}", r"# \text{ on the left}",
    r"\text{domain }[#,7]", r"\text{maximum at }(#,2)", "the charge is $#$ at most", r"\text{Ion}^{#}",
    r"\text{spin }#,\text{ mass }3", r"\text{increasing for } x > #", r"\text{no more than \(#\) times}",
    "diverges to $#$", "A: #, B: 9", "P: #", r"\text{the value is } # \text{ or less}", "(a) # (b) 5",
]  # fmt: skip
FORMULAS = ["-3", "+3", "2+", "2-", "x-y", r"-\infty", r"-\frac{1}{2}", "a^{-2}", r"\sqrt{2}-1", "3x+1", "-x"]
TURNED = dict(zip("+-<>[]()", "-+><()[]", strict=True))
WORDED = (Path(__file__).parent / "worded.txt").read_text(encoding="utf-8").splitlines()


def right(answer: str, gold: str) -> bool:
    """Return the verdict on a boxed answer."""
    return grade(f"\\boxed{{{answer}}}", gold, timeout_s=10).correct


@settings(max_examples=120)
@given(st.sampled_from(SENTENCES), st.sampled_from(FORMULAS), st.data())
def test_a_flipped_sign_among_words_is_wrong_and_the_gold_itself_right(
    sentence: str, formula: str, data: st.DataObject
):
    """Also with white space around it; other brackets are another answer as well."""
    gold = sentence.replace("#", formula)
    assert right(gold, gold)
    assert right(gold.replace("$", " "), gold)
    place = data.draw(st.sampled_from([at for at, sign in enumerate(formula) if sign in "+-"]))
    flipped = formula[:place] + {"+": "-", "-": "+"}[formula[place]] + formula[place + 1 :]
    assert not right(sentence.replace("#", flipped), gold)
    if "[#" in sentence or "}(#" in sentence:
        assert not right(gold.translate(str.maketrans("()[]", "[]()")), gold)
    assert not right(sentence.replace("#", "8"), gold)


def test_a_gold_of_several_lines_is_the_gold_as_a_whole():
    """Each line counts, in any order if they are named; what begins with a relation goes on with the line before."""
    gold = "$x=1$\n$y=2$"
    assert [right(answer, gold) for answer in ("x=1, y=2", "y=2, x=1", "(1,2)", "1, 2")] == [True] * 4
    assert [right(answer, gold) for answer in ("2", "1", "x=1, y=3", "x=2, y=1", "y=2")] == [False] * 5
    assert right("4", "$x=2+2$\n$=4$")


def test_no_sign_relation_or_bracket_among_words_is_lost():
    """Of each gold, each sign and mark turned alone makes another answer; so does a minus that is left out."""
    passed = []
    for gold in WORDED:
        assert right(gold, gold)
        for place, sign in enumerate(gold):
            if sign not in TURNED or (gold[place - 1 : place] == "\\" and sign in "()"):
                continue
            others = [TURNED[sign], " "] if sign == "-" else [TURNED[sign]]
            answers = [gold[:place] + other + gold[place + 1 :] for other in others]
            passed += [(gold, answer) for answer in answers if right(answer, gold)]
    assert passed == []
