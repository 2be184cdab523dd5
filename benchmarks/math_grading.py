r"""After a change of gem_math.grading: answers graded in a second, by gem-llm's MathEnv and ours, each within 1 s.

Half of the pairs are plain (numbers, fractions, decimals), half are written in another form, so that they need symbolic
comparison (radicals, polynomials, trigonometry, sets); half of each are right. No pair comes twice, and nothing is
remembered. Each side makes one environment and answers row after row, as it comes: the peer's with the process that is
its default.

The second table has another mixture, as models answer: most are numbers or written like the gold answer, one in five
needs more. They are graded by ``gem_math.grade`` and by math-verify alone, in this process and without a limit.
"""

from __future__ import annotations

import harness

BUDGET = 3.0
PAIRS = 400
RESPONSES = 500
MOST_REPEATS = 3  # a round takes the peer and math-verify half a minute

MAKE_PAIRS = r'''
import json, sys, time

def pairs(count):
    """Return (gold answer, answer, whether it is right): plain ones and others by turns."""
    made = []
    for n in range(count // 2):
        k, right = n + 2, n % 4 < 2
        shift = 0 if right else 1
        plain = [
            (str(17 * k), f"{17 * k + shift}.0"),
            (f"\\frac{{{k}}}{{{4 * k + 1}}}", f"{2 * k}/{8 * k + 2 + shift}"),
            (f"{k / 8}", f"\\frac{{{k + shift}}}{{8}}"),
            (f"{1000 * k + 7:,}", str(1000 * k + 7 + shift)),
        ][n % 4 if n % 8 < 4 else 3 - n % 4]
        other = [
            (f"{k}\\sqrt{{3}}", f"\\sqrt{{{3 * k * k + shift}}}"),
            (f"(x+{k})(x-{2 * k})", f"x^2-{k + shift}x-{2 * k * k}"),
            (f"\\frac{{{k}\\pi}}{{{2 * k + 3}}}", f"\\frac{{{2 * k}}}{{{4 * k + 6 + shift}}}\\pi"),
            (f"\\frac{{1}}{{\\sqrt{{{k}}}+1}}", f"\\frac{{\\sqrt{{{k + shift}}}-1}}{{{k - 1}}}"),
            (f"{k}\\sin(x)\\cos(x)", f"\\frac{{{k + shift}\\sin(2x)}}{{2}}"),
            (f"\\{{{k}, \\sqrt{{{k}}}\\}}", f"\\{{{k}^{{1/2}}, {k + shift}\\}}"),
        ][n % 6]
        made += [(*plain, right), (*other, right)]
    assert len(set(made)) == len(made)
    return made
'''

OURS = (
    MAKE_PAIRS
    + r"""
from gem_math import MathEnv

made = pairs(COUNT)
env = MathEnv([{"problem": "?", "answer": gold} for gold, _, _ in made], question_key="problem")
verdicts, spent = [], 0.0
for index, (_, answer, _) in enumerate(made):
    env.reset(options={"index": index})
    started = time.perf_counter()
    verdicts.append(env.step(f"Let us see. The answer is \\boxed{{{answer}}}.")[4]["correct"])
    spent += time.perf_counter() - started
wrong = sum(verdict != right for verdict, (_, _, right) in zip(verdicts, made))
print(json.dumps({"per_s": COUNT / spent, "wrong": wrong}))
"""
)

PEER = (
    MAKE_PAIRS
    + r"""
from datasets import Dataset
from gem.envs.math_env import MathEnv

made = pairs(COUNT)
rows = Dataset.from_list([{"problem": "?", "answer": gold} for gold, _, _ in made])
env = MathEnv(dataset=rows, eval=True)
verdicts, spent = [], 0.0
for index, (_, answer, _) in enumerate(made):
    env.reset(idx=index)
    started = time.perf_counter()
    verdicts.append(env.step(f"Let us see. The answer is \\boxed{{{answer}}}.")[4]["correct"])
    spent += time.perf_counter() - started
env.mp_pool.terminate()
wrong = sum(verdict != right for verdict, (_, _, right) in zip(verdicts, made))
print(json.dumps({"per_s": COUNT / spent, "wrong": wrong}))
"""
)

MAKE_RESPONSES = r'''
import json, time

def responses(count):
    """Return (gold answer, response, whether it is right) as models give them."""
    made = []
    for k in range(2, count // 10 + 2):
        pairs = [
            (f"{7 * k}", f"{7 * k}", True), (f"{7 * k}", f"{7 * k}", True), (f"{13 * k}", f"{13 * k + 1}", False),
            (f"{1000 * k}", f"{k},000", True), (f"\\frac{{{k}}}{{8}}", f"{k / 8}", True),
            (f"{k} \\text{{ cm}}", f"{k}\\text{{ cm}}", True), (f"{k}\\sqrt{{3}}", f"{k}\\sqrt{{3}}", True),
            (f"({k}, {k + 1})", f"({k},{k + 2})", False), (f"{k}\\pi", f"\\frac{{{2 * k}\\pi}}{{2}}", True),
            (f"x^2+{2 * k}x+{k * k}", f"(x+{k})^2", True),
        ]
        thoughts = "Let us think. " * 40
        made += [(gold, thoughts + f"So it is $\\boxed{{{answer}}}$.", right) for gold, answer, right in pairs]
    return made

made = responses(COUNT)
'''

OUR_RESPONSES = (
    MAKE_RESPONSES
    + r"""
from gem_math import grade

grade("\\boxed{2x}", "x+x")  # starts a process
started = time.perf_counter()
wrong = sum(grade(response, gold).correct != right for gold, response, right in made)
print(json.dumps({"per_s": len(made) / (time.perf_counter() - started), "wrong": wrong}))
"""
)

MATH_VERIFY = (
    MAKE_RESPONSES
    + r"""
from math_verify import parse, verify

def same(gold, response):
    return verify(parse(f"${gold}$", parsing_timeout=None), parse(response, parsing_timeout=None), timeout_seconds=None)

same("x+x", "\\boxed{2x}")
started = time.perf_counter()
wrong = sum(same(gold, response) != right for gold, response, right in made)
print(json.dumps({"per_s": len(made) / (time.perf_counter() - started), "wrong": wrong}))
"""
)


def main() -> None:
    """Measure and print the table."""
    sides = harness.arguments()
    results = harness.measure(
        {
            "gem_math": harness.snippet(sides.ours, OURS.replace("COUNT", str(PAIRS))),
            "gem-llm": harness.snippet(sides.peer, PEER.replace("COUNT", str(PAIRS))),
            "responses": harness.snippet(sides.ours, OUR_RESPONSES.replace("COUNT", str(RESPONSES))),
            "math-verify": harness.snippet(sides.ours, MATH_VERIFY.replace("COUNT", str(RESPONSES))),
        },
        repeats=min(sides.repeats, MOST_REPEATS),
        warm_up=1,
    )
    ours, peer = results["gem_math"], results["gem-llm"]
    ratio = ours.median("per_s") / peer.median("per_s")
    harness.print_table(
        f"Graded answers a second, {PAIRS} pairs, half of them in another form",
        ["", "answers/s", "wrong verdicts", "ratio", f"budget {BUDGET:g}"],
        [
            ["gem-llm", f"{peer.median('per_s'):.0f}", f"{peer.median('wrong'):.0f}", "1.0", ""],
            [
                "gem-math",
                f"{ours.median('per_s'):.0f}",
                f"{ours.median('wrong'):.0f}",
                f"{ratio:.1f}",
                harness.verdict(ratio, BUDGET, at_least=True),
            ],
        ],
    )
    both = [results[name] for name in ("math-verify", "responses")]
    harness.print_table(
        f"Responses a second, {RESPONSES} of them, one in five in another form",
        ["", "answers/s", "wrong verdicts", "ratio"],
        [
            [
                name,
                f"{case.median('per_s'):.0f}",
                f"{case.median('wrong'):.0f}",
                f"{case.median('per_s') / both[0].median('per_s'):.1f}",
            ]
            for name, case in zip(("math-verify alone", "gem-math"), both, strict=True)
        ],
    )


if __name__ == "__main__":
    main()
