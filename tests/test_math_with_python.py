"""Scripted agents solve problems of ``math:Sample`` and ``rg:*`` with the real Python tool, in its sandbox."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem

pytest.importorskip("gem_math", reason="the problems come with gem-math")
pytest.importorskip("gem_tools", reason="the Python tool comes with gem-tools")

# What a problem says, and the program that solves it with the values of the groups.
MATH = {
    r"largest whole number that divides both (\d+) and (\d+)\?": "import math; print(math.gcd({0}, {1}))",
    r"ring every (\d+), (\d+) and (\d+) minutes": "import math; print(math.lcm({0}, {1}, {2}))",
    r"remainder when \$(\d+)\^\{(\d+)\}\$ is divided by \$(\d+)\$": "print(pow({0}, {1}, {2}))",
    r"Write the decimal number (\d+) in base (\d+)": (
        "number, digits = {0}, ''\nwhile number:\n    number, digit = divmod(number, {1})\n"
        "    digits = str(digit) + digits\nprint(digits)"
    ),
    r"List all positive divisors of (\d+) as a set": (
        "print('{{' + ', '.join(str(n) for n in range(1, {0} + 1) if {0} % n == 0) + '}}')"
    ),
    r"Multiply: \$([\d.]+) \\times ([\d.]+)\$": "from decimal import Decimal; print(Decimal('{0}') * Decimal('{1}'))",
    r"sides (\d+), (\d+) and (\d+)\. Is it acute, right or obtuse": (
        "a, b, c = sorted([{0}, {1}, {2}])\nrest = a * a + b * b - c * c\n"
        "print('right' if not rest else 'acute' if rest > 0 else 'obtuse')"
    ),
    r"Compute \$\((-?\d+[+-]\d+)i\)\((-?\d+[+-]\d+)i\)\$": (
        "product = complex('{0}j') * complex('{1}j')\nprint(f'{{product.real:.0f}}{{product.imag:+.0f}}i')"
    ),
}
REASONING = {
    "gcd": {r"of these numbers: ([\d, ]+)\.": "import math; print(math.gcd(*[{0}]))"},
    "lcm": {r"of these numbers: ([\d, ]+)": "import math; print(math.lcm(*[{0}]))"},
    "chain_sum": {r"problem: ([\d +-]+) =": "print({0})"},
    "letter_counting": {r'letter "(\w)" appear in the text: "([^\n]*)"': "print({1!r}.lower().count('{0}'))"},
    "prime_factorization": {
        r"factorization of (\d+)\.": (
            "n, factors, d = {0}, [], 2\nwhile n > 1:\n    if n % d:\n        d += 1\n        continue\n"
            "    factors.append(d)\n    n //= d\nprint(' × '.join(map(str, factors)))"
        )
    },
    "simple_equations": {
        r"(?:for|of) ([a-z])\b[^:\n]*: (.+?) = (-?\d+)": (
            "import re\nleft = re.sub('{0}', '(v)', '{1}')\n"
            "print(next(v for v in range(-3000, 3000) if eval(left) == {2}))"
        )
    },
}


class Programmer:
    """Writes the program for a problem that it knows, runs it by the tool, and boxes what the program printed."""

    def __init__(self, programs: dict[str, str]) -> None:
        self.programs = programs

    def __call__(self, observation: str, context: Any) -> str:
        """Return the call, or the answer."""
        if context.turn:
            printed = re.search(r"Output of python:\n(.*)\n", observation)
            return f"\\boxed{{{printed[1] if printed else ''}}}"
        for pattern, program in self.programs.items():
            if match := re.search(pattern, observation):
                return f"Let us compute.\n```python\n{program.format(*match.groups())}\n```"
        return "I do not know this one."


def programmed(ids: str, programs: dict[str, str], **run: Any) -> list[Any]:
    """Return the episodes of a programmer with the Python tool."""
    with gem.make_vec(ids, 2, wrappers="python", seed=3) as vector:
        return list(gem.rollout(vector, Programmer(programs), **run))


@pytest.mark.thorough
def test_an_agent_solves_problems_of_the_sample_with_the_python_tool() -> None:
    """The 40 problems of eight families, in two turns each; what it has no program for, it does not solve."""
    with gem.make("math:Sample") as env:
        problems = [str(env.reset(options={"index": index})[0]) for index in range(env.unwrapped.num_tasks)]
    known = [index for index, text in enumerate(problems) if any(re.search(pattern, text) for pattern in MATH)]
    others = [index for index in range(len(problems)) if index not in known][:8]
    assert len(known) == 40
    plan = [gem.PlanItem(options={"index": index}) for index in known + others]
    episodes = programmed("math:Sample", MATH, plan=plan)
    assert len(episodes) == len(plan)
    solved = sorted(episode.options["index"] for episode in episodes if episode.success)
    assert solved == known
    assert {episode.turns for episode in episodes if episode.success} == {2}


@pytest.mark.thorough
@pytest.mark.parametrize("name", REASONING)
def test_an_agent_solves_reasoning_tasks_with_the_python_tool(name: str) -> None:
    """Six rows of each, scored by reasoning-gym's own scorer, in two turns each."""
    pytest.importorskip("reasoning_gym", reason="the tasks are reasoning-gym's")
    episodes = programmed(f"rg:{name}", REASONING[name], episodes=6)
    assert [(episode.success, episode.turns, episode.episode_return) for episode in episodes] == [(True, 2, 1.0)] * 6


def test_a_program_that_is_wrong_gets_no_reward() -> None:
    """That the tool succeeds is no success of the task's."""
    pytest.importorskip("reasoning_gym", reason="the tasks are reasoning-gym's")
    wrong = {r"of these numbers: ([\d, ]+)\.": "print(max({0}) + 1)"}
    episodes = programmed("rg:gcd", wrong, episodes=4)
    assert [(episode.success, episode.turns) for episode in episodes] == [(False, 2)] * 4
