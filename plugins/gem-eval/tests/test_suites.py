"""Suites: what their files may say, and conditions on rows."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core import extract_code_blocks
from gem_core.errors import ArgumentError
from gem_core.registry import registry
from gem_eval.running.conditions import parse_condition
from gem_eval.running.prices import load_prices
from gem_eval.suites import builtin_suites, combined_suite, load_suite
from gem_eval.suites.suite import parse_suite


@pytest.mark.parametrize("name", builtin_suites())
def test_a_suite_that_is_built_in_names_environments_that_there_are(name: str) -> None:
    """And says what it is for."""
    suite = load_suite(name)
    assert suite.description
    for task in suite.tasks:
        namespace = task.id.partition(":")[0]
        if not registry().install_hint(namespace, "namespace"):  # its plugin is installed here
            gem.spec(task.id)


def test_the_suite_in_the_documentation_is_one() -> None:
    """To the letter."""
    page = Path(__file__).parents[3] / "docs" / "evaluation.md"
    (block,) = [block for block in extract_code_blocks(page.read_text()) if block.language == "yaml"]
    suite = parse_suite(block.code.encode(), str(page), default_name="page")
    assert [task.label for task in suite.with_defaults()] == ["math:GSM8K", "GSM8K-python", "game:*-easy"]


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def test_a_suite_of_a_file_has_defaults_for_its_tasks(tmp_path: Path) -> None:
    """Keyword arguments are joined, all else is replaced."""
    text = """
defaults: {tools: [python, search: {top_k: 2}], kwargs: {a: 1, b: 1}, limit: 5}
tasks:
  - id: math:Sample
  - {id: qa:Sample, tools: [], kwargs: {b: 2}, limit: 7}
models: [random, {agent: "openai:m", name: cold, options: {temperature: 0}}]
"""
    suite = load_suite(written(tmp_path, text))
    one, two = suite.with_defaults()
    assert suite.name == "mine"
    assert (one.tools, one.kwargs, one.limit) == ((("python", {}), ("search", {"top_k": 2})), {"a": 1, "b": 1}, 5)
    assert (two.tools, two.kwargs, two.limit) == ((), {"a": 1, "b": 2}, 7)
    assert [model.label for model in suite.models] == ["random", "cold"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tasks: [{id: a:B, limt: 3}]", "tasks.0.limt: Extra inputs are not permitted. Did you mean 'limit'?"),
        ("epoch: 2\ntasks: [{id: a:B}]", "epoch: Extra inputs are not permitted. Did you mean 'epochs'?"),
        ("tasks: []", "tasks: "),
        ("tasks: [{id: a:B, limit: 0}]", "tasks.0.limit: "),
        ('tasks: [{id: a:B, name: "a\\nb"}]', "tasks.0.name: "),
        ("[1, 2]", "is no suite: it must be a mapping with 'tasks', not list"),
        ("tasks: [", "is no YAML: "),
        ("!!python/object/apply:os.system [echo]", "is no YAML: could not determine a constructor"),
        ("\x00", "is no YAML: "),
    ],
)
def test_what_is_wrong_with_a_suite_is_named_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    """Whatever stands in the file."""
    with pytest.raises(ArgumentError) as caught:
        load_suite(written(tmp_path, text))
    assert message in str(caught.value)


def test_targets_are_joined_into_one_suite() -> None:
    """Suites, ids and globs beside each other."""
    suite = combined_suite(["tau-sample", "math:Sample", "game:*-easy"])
    assert [task.id for task in suite.tasks] == ["tau:Sample-solo", "math:Sample", "game:*-easy"]
    assert suite.name == "tau-sample-math-Sample-game-easy"


def test_suites_that_differ_in_what_holds_for_a_run_are_refused(tmp_path: Path) -> None:
    """One of them would be played by the other's rules."""
    (tmp_path / "two.yaml").write_text("tasks: [{id: a:B}]\nepochs: 3")
    with pytest.raises(ArgumentError, match="the suites differ in epochs, which holds for a whole run"):
        combined_suite([written(tmp_path, "tasks: [{id: a:B}]\nepochs: 2"), tmp_path / "two.yaml"])


ROW = {"level": 5, "subject": "Algebra", "year": 2024, "tags": ["a", "b"], "text": "x"}


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("level == 5", True),
        ("level != 5", False),
        ("level >= 4 and subject == 'Algebra'", True),
        ("not (subject in ['Geometry', 'Algebra'])", False),
        ("subject not in ('Geometry',)", True),
        ("2000 < year <= 2024", True),
        ("year == -2024", False),
        ("'a' in tags", True),
        ("text == 5 or year == 2024", True),
        ("year == '2024'", False),
    ],
)
def test_a_condition_holds_or_not(condition: str, holds: bool) -> None:
    """As Python says."""
    assert parse_condition(condition)(ROW) is holds


@pytest.mark.parametrize(
    "condition",
    ["", "level = 5", "__import__('os')", "level.real", "[x for x in tags]", "1" + "+1" * 400, "lambda: 1", "tags[0]"],
)
def test_what_is_no_condition_is_refused(condition: str) -> None:
    """Nothing but comparisons is ever executed."""
    with pytest.raises(ArgumentError, match="is no condition"):
        parse_condition(condition)


def test_a_condition_that_does_not_fit_the_rows_says_why() -> None:
    """An unknown column with the nearest, and an order of text and number."""
    with pytest.raises(ArgumentError, match=r"'levle'.*Did you mean 'level'"):
        parse_condition("levle == 5")(ROW)
    with pytest.raises(ArgumentError, match="not supported between"):
        parse_condition("text > 5")(ROW)


@given(st.text(max_size=40))
def test_no_text_of_a_condition_crashes(text: str) -> None:
    """It is a condition, or an error that says so."""
    with contextlib.suppress(ArgumentError):
        parse_condition(text)(ROW)


@pytest.mark.parametrize(
    ("agent", "usage", "dollars"),
    [
        ("openai:gpt-5-mini", {"prompt_tokens": 1_000_000, "completion_tokens": 0}, 0.25),
        ("openai:gpt-5-mini-2025-08-07", {"prompt_tokens": 0, "completion_tokens": 1_000_000}, 2.0),
        (
            "gpt-5",
            {"prompt_tokens": 1_000_000, "completion_tokens": 0, "prompt_tokens_details": {"cached_tokens": 600_000}},
            0.4 * 1.25 + 0.6 * 0.125,
        ),
        ("openai:gpt-5", {"prompt_tokens": "many", "completion_tokens": None, "prompt_tokens_details": 3}, 0.0),
    ],
)
def test_tokens_have_a_price(agent: str, usage: dict[str, Any], dollars: float) -> None:
    """Those that the server had kept have their own."""
    price = load_prices().find(agent)
    assert price is not None
    assert price.of(usage) == pytest.approx(dollars)


def test_a_file_of_prices_that_is_wrong_is_named(tmp_path: Path) -> None:
    """With the place."""
    (tmp_path / "p.json").write_text('{"models": {"m": {"input": -1, "output": 2}}}')
    with pytest.raises(ArgumentError, match=r"is no file of prices: models\.m\.input: Input should be greater than"):
        load_prices(tmp_path / "p.json")
    with pytest.raises(ArgumentError, match="cannot read the prices in"):
        load_prices(tmp_path / "none.json")
