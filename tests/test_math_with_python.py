"""A scripted agent solves problems of ``math:Sample`` with the real Python tool, in its sandbox."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem

pytest.importorskip("gem_math", reason="the problems come with gem-math")
pytest.importorskip("gem_tools", reason="the Python tool comes with gem-tools")

GCD = {r"largest whole number that divides both (\d+) and (\d+)\?": "import math; print(math.gcd({0}, {1}))"}
"""What a problem says, and the program that solves it with the values of the groups."""


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


def programmed(programs: dict[str, str], **run: Any) -> list[Any]:
    """Return the episodes of a programmer with the Python tool."""
    with gem.make_vec("math:Sample", 2, wrappers="python", seed=3) as vector:
        return list(gem.rollout(vector, Programmer(programs), **run))


def test_an_agent_solves_problems_of_the_sample_with_the_python_tool() -> None:
    """In two turns each; what it has no program for, it does not solve."""
    with gem.make("math:Sample") as env:
        problems = [str(env.reset(options={"index": index})[0]) for index in range(env.unwrapped.num_tasks)]
    known = [index for index, text in enumerate(problems) if re.search(next(iter(GCD)), text)]
    other = next(index for index in range(len(problems)) if index not in known)
    plan = [gem.PlanItem(options={"index": index}) for index in (*known, other)]
    solved = {episode.options["index"]: episode.turns for episode in programmed(GCD, plan=plan) if episode.success}
    assert solved == dict.fromkeys(known, 2)
    assert len(known) == 5


def test_a_program_that_is_wrong_gets_no_reward() -> None:
    """That the tool succeeds is no success of the task's."""
    episodes = programmed({r"[\s\S]": "print('nonsense')"}, episodes=4)
    assert [(episode.success, episode.turns) for episode in episodes] == [(False, 2)] * 4
