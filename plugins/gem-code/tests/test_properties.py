"""What holds for any program and any data."""

from __future__ import annotations

import asyncio
from typing import Any

from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from gem_code.cases import AssertionTests, CallTests
from gem_code.code_env import CodeEnv
from gem_code.fences import last_program
from gem_code.function_form import grade_assertions, grade_calls
from gem_code.program_form import Grading
from gem_code.runner import Runner
from gem_core.testing import hostile_actions

LANGUAGES = (*CodeEnv.answer_fences, "python3")
_DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(st.text(), st.text(), st.sampled_from(LANGUAGES))
@example("before", "x = '``'\n", "python")
def test_a_program_comes_out_as_it_was_written(before: str, code: str, language: str) -> None:
    """Behind any text, whatever it holds but fences."""
    for mark in ("```", "~~~", "</think>", "\r"):
        assume(mark not in before)
        assume(mark not in code)
    assume(not code.endswith("`"))
    assert last_program(f"{before}\n```{language}\n{code}\n```\n", LANGUAGES) == code


@given(
    st.lists(st.sampled_from(["```", "```python", "\n", "a", " ", "~~~", "</think>", "<think>", "````"])).map("".join)
)
def test_any_response_has_a_program_or_none(response: str) -> None:
    """Fences in any disorder; what is found stands in the response."""
    found = last_program(response, LANGUAGES)
    assert found is None or all(line.strip() in response for line in found.splitlines())


def test_hostile_responses_are_read() -> None:
    """Megabytes of anything, which work of quadratic time would not get through."""
    for action in [*hostile_actions(), "```" * 300_000, "a```python\n" * 100_000, "</think>```" * 50_000]:
        found = last_program(action, LANGUAGES)
        assert found is None or len(found) <= len(action)


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.lists(_DATA, max_size=2), _DATA), min_size=1, max_size=5), st.data())
def test_a_table_of_the_answers_passes_and_with_one_changed_fails(table: list[Any], data: Any) -> None:
    """For any arguments and results, in both forms of function tests."""
    unique = {repr(arguments): (arguments, result) for arguments, result in table}
    pairs = list(unique.values())
    changed = data.draw(st.integers(0, len(pairs) - 1))
    right = f"inf = float('inf')\ndef f(*a):\n    return {dict((repr(tuple(k)), v) for k, v in pairs)!r}[repr(a)]\n"
    other = repr(tuple(pairs[changed][0]))
    wrong = f"{right}g = f\ndef f(*a):\n    return ['other', g(*a)] if repr(a) == {other!r} else g(*a)\n"
    source = "inf = float('inf')\n" + "".join(f"assert f(*{k!r}) == {v!r}\n" for k, v in pairs)
    calls = CallTests("f", tuple(k for k, _ in pairs), tuple(v for _, v in pairs))

    async def statuses(code: str) -> list[list[str]]:
        runner, grading = Runner(), Grading(every=True)
        by_assertions = await grade_assertions(code, AssertionTests(source), runner, grading)
        by_calls = await grade_calls(code, calls, runner, grading)
        return [[test.status for test in verdict.tests] for verdict in (by_assertions, by_calls)]

    expected = ["passed"] * len(pairs)
    assert asyncio.run(statuses(right)) == [expected, expected]
    expected[changed] = "wrong_answer"
    assert asyncio.run(statuses(wrong)) == [expected, expected]
