"""Whatever the gold answer is: written again it is right, another answer is wrong, and neither is an error."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_math import grade

# As in MATH, OlympiadBench, Minerva, DeepMath, Omni-MATH and college mathematics, with their slips.
CORES = ["5", r"\frac{1}{2}", "x+1", r"\sqrt{2}", r"\text{yes}", "(1,2)", r"\{1,2\}", "x=3", r"2\pi", "[0,1)"]
AROUND = [
    r"# \\", r"\, #", r"# \text{ units}^2", r"# \mathrm{~min}", r"# \mathrm{~sec}", r"# \mathrm{~m} / \mathrm{s}^{2}",
    r"#^{\circ} \mathrm{C}", r"\$ #", r"# \%", r"\left. # \right.", r"\left( # \right)", "$#$", r"\boxed{#}", "#.",
    r"\displaystyle{#}", r"{\rm #}", r"\textbf{(A)} #", r"# \text{ or } #", "i = #", "e = #", "y = #", "# = #",
    r"# \cup (3,4)", r"# \bigcup #", r"\bigcup_{k \in \mathbb{Z}} #", r"# \pmod{5}", r"x \equiv # \pmod{7}",
    r"# (\text{mod } 5)", r"# \text{ for all } n \ge 1", r"\begin{aligned} # \end{aligned}", r"# : 3", r"# \neq 2",
    r"\begin{pmatrix} # \\ # \end{pmatrix}", r"\begin{cases} # & x > 0 \\ 0 & \text{otherwise} \end{cases}",
    r"\left\{\begin{array}{l} # \\ # \end{array}\right.", r"\max\{#, 3\}", r"f(#) = 3", r"# + C", r"\unknown{#} z",
    r"\int_0^# x\, dx", r"#, \ldots, n", r"\overset{\frown}{AB} = #", r"# \Rightarrow y", r"{\{#", r"\frac{#}{",
    r"\sqrt{#", "(#", "#)", r"\left( #", r"\begin{cases} #", r"# ^", "_ #", r"# \frac", "# & 3", "<#>", '"#"', "=#",
]  # fmt: skip
WHOLE = [
    r"\text{no solution}", r"\text{Monday}", "Bob wins for n even, Alice for n odd", "See proof", r"\text{(D)}", "C",
    r"\text{A, B}", "July 4, 2020", "3:30 p.m.", r"2 \text{ hours } 30 \text{ minutes}", r"5'6\"", r"120_8",
    r"2\frac{1}{3}", "1,234,567", r"10{,}080", "2^{2^{2^{2}}}", r"\$18{,}000", r"1.6e-19", r"-31.4 \mathrm{~kJ}",
    r"\mathbb{Z}_{2} \times \mathbb{Z}_{3}", r"O(n \log n)", r"a \mid b", r"\forall x", r"A \setminus B", r"\square",
    r"x \in (-\infty,2)\cup(3,\infty)", r"\mathbb{R} \setminus \{0\}", r"y = C_1 e^{x} + C_2 e^{-x}", "±3", "→ 3", "五",
    r"\lim_{x\to 0} \frac{\sin x}{x}", r"\underbrace{11\cdots1}_{n}", "1^2^3", "x__2", "(1,,2)", "(,)", "5=", "x<",
    r"\textcolor{red}{5}", r"\$", "?", "-", r"\frac", "x" * 5000, "1," * 300 + "1", r"\oint \mathfrak{g}",
]  # fmt: skip
GOLDS = [around.replace("#", core) for around in AROUND for core in CORES] + WHOLE


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
