"""The hostile actions: enough of them, of every class, and the same each time."""

from __future__ import annotations

import json
import re
from collections.abc import Callable

import pytest

from gem_core.testing import hostile_actions

ACTIONS = hostile_actions()


def test_there_are_at_least_200_different_ones() -> None:
    assert len(ACTIONS) == len(set(ACTIONS)) >= 200
    assert len(hostile_actions(count=1)) >= 200
    assert len(hostile_actions(count=500)) == 500
    assert hostile_actions(seed=4) == hostile_actions(seed=4) != hostile_actions(seed=5)


def test_all_are_strings_that_json_keeps() -> None:
    """What a check reports about them can be written down, lone surrogates included."""
    assert json.loads(json.dumps(ACTIONS)) == ACTIONS


@pytest.mark.parametrize(
    "is_one",
    [
        pytest.param(lambda text: text == "", id="empty"),
        pytest.param(lambda text: len(text) >= 5_000_000, id="5 MB"),
        pytest.param(lambda text: any("\ud800" <= c <= "\udfff" for c in text), id="lone surrogate"),
        pytest.param(lambda text: "\x00" in text, id="NUL byte"),
        pytest.param(lambda text: text.count("\\boxed{") > 1000 and "}" not in text, id="unclosed boxes"),
        pytest.param(lambda text: "٣" in text, id="Arabic-Indic digits"),
        pytest.param(lambda text: re.fullmatch("9{5000}", text), id="5,000 digits"),
        pytest.param(lambda text: text.startswith("[" * 1000), id="deep JSON"),
        pytest.param(lambda text: "<tool_call>" in text and "no_such_tool" in text, id="tool call"),
        pytest.param(lambda text: text.count("<python>") > 1000, id="many opening tags"),
        pytest.param(lambda text: "__class__" in text, id="str.format"),
    ],
)
def test_every_class_is_there(is_one: Callable[[str], object]) -> None:
    assert any(is_one(action) for action in ACTIONS)
