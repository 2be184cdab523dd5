"""Formulas among words: no sign, bracket or mark of theirs is lost, and none makes a right answer wrong."""

from __future__ import annotations

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gem_math import grade

SENTENCES = [
    "slope is $#$", r"\text{slope is }#", r"\text{the line } # \text{ is tangent}", r"# \text{ on the left}",
    r"\text{domain }[#,7]", r"\text{maximum at }(#,2)", "the charge is $#$ at most", r"\text{Ion}^{#}",
    r"\text{spin }#,\text{ mass }3", r"\text{increasing for } x > #", r"\text{no more than \(#\) times}",
    "diverges to $#$", "A: #, B: 9", "P: #", r"\text{the value is } # \text{ or less}", "(a) # (b) 5",
]  # fmt: skip
FORMULAS = ["-3", "+3", "2+", "2-", "x-y", r"-\infty", r"-\frac{1}{2}", "a^{-2}", r"\sqrt{2}-1", "3x+1", "-x"]
OTHER_BRACKETS = str.maketrans("()[]", "[]()")


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
        assert not right(gold.translate(OTHER_BRACKETS), gold)
    assert not right(sentence.replace("#", "8"), gold)


@settings(max_examples=60)
@given(st.permutations(["x", "7", "x-7", "2x"]), st.sampled_from(["lies above", "is at most", "meets"]))
def test_formulas_among_words_are_compared_in_their_order(formulas: list[str], verb: str):
    """What lies above another does not lie below it."""
    one, other = formulas[:2]
    gold, turned = f"${one}$ {verb} ${other}$", f"${other}$ {verb} ${one}$"
    assume(one != other)
    assert right(gold, gold)
    assert not right(turned, gold)


def test_a_gold_of_several_lines_is_the_gold_as_a_whole():
    """Each line counts, in any order if they are named; what begins with a relation goes on with the line before."""
    gold = "$x=1$\n$y=2$"
    assert [right(answer, gold) for answer in ("x=1, y=2", "y=2, x=1", "(1,2)", "1, 2")] == [True] * 4
    assert [right(answer, gold) for answer in ("2", "1", "x=1, y=3", "x=2, y=1", "y=2")] == [False] * 5
    assert right("4", "$x=2+2$\n$=4$")
