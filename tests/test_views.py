"""Observation views: what they show, and what they leave alone."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from toys import CountdownEnv, EchoEnv

import gem_core as gem
from gem_core.env.guard import Guard
from gem_core.env.observations import join_observations
from gem_core.parsing import visible_text, without_thinking
from gem_core.wrappers.views import Concat, ConcatWithAction, Latest, ObservationView


def played(view: ObservationView, actions: list[str]) -> list[gem.Observation]:
    observations = [view.reset(seed=1, options={"left": 100})[0]]
    return observations + [view.step(action)[0] for action in actions]


@pytest.mark.parametrize(
    ("view_class", "options", "shown"),
    [
        (Latest, {}, "You said 'b'.\nLeft: 98."),
        (Concat, {}, "Count down.\nYou said 'a'.\nYou said 'b'.\nLeft: 98."),
        (ConcatWithAction, {}, "Count down.\na\nYou said 'a'.\nb\nYou said 'b'.\nLeft: 98."),
        (ConcatWithAction, {"max_turns": 1}, "Count down.\nb\nYou said 'b'.\nLeft: 98."),
    ],
)
def test_views_show_feedback_and_the_suffix_once(view_class: Any, options: Any, shown: str) -> None:
    """At the end; a limit drops turns from the middle, never the task; ``info`` still holds what the task wrote."""
    view = view_class(Guard(CountdownEnv()), **options)
    assert played(view, ["a", "b"])[-1] == shown
    other = view.fork()
    result = view.step("c")
    assert other.step("c") == result
    assert (result[4]["feedback"], result[4]["suffix"]) == ("You said 'c'.\n", "Left: 97.")


def test_drop_thinking_leaves_out_thinking_of_earlier_turns() -> None:
    """Thinking goes from the view; the action that the task gets is whole."""
    view = ConcatWithAction(EchoEnv(), drop_thinking=True)
    view.reset(seed=1)
    observation = view.step("<think>long</think>hi")[0]
    assert observation == "Say something.\nhi\nHeard: <think>long</think>hi"


@pytest.mark.parametrize(
    ("action", "left"),
    [
        ("<think>a</think>b", "b"),
        ("a</think> b", "b"),
        ("x<think>a</think>b<think>c</think>d", "xd"),
        ("x<think>never closed", "x"),
        ("<think>a</think>b<think>open", "b"),
        ("</think>", ""),
        ("x[THINK]a[/THINK]y", "xy"),
        ("<think>a</think>b<seed:think>c", "b"),
        ("a</mm:think>b<longcat_think>c", "b"),
        ("<|channel>thought\na<channel|>b", "b"),
        ("◁think▷a◁/think▷b<thinking>c</thinking>d", "bd"),
    ],
)
def test_without_thinking(action: str, left: str) -> None:
    """Blocks that are whole, only closed or never closed all go."""
    assert without_thinking(action) == left


@given(st.text(alphabet="<>/thinkab "))
def test_no_thinking_is_left(action: str) -> None:
    """Whatever the response, no tag of thinking remains."""
    rest = without_thinking(action)
    assert "<think>" not in rest


def test_content_parts_are_joined_as_parts() -> None:
    """Once there is an image, everything becomes parts, and texts stay on lines of their own."""
    image = {"type": "image", "image": object()}
    pieces: list[gem.Observation] = ["Look:", [image, {"type": "text", "text": "a"}], "b"]
    assert join_observations(pieces) == [
        {"type": "text", "text": "Look:\n"},
        image,
        {"type": "text", "text": "a\n"},
        {"type": "text", "text": "b"},
    ]


@pytest.mark.parametrize(
    ("response", "said"),
    [
        ("<think>secret</think>\nHello.<|im_end|>", "Hello."),
        ("secret</think>Hello.", "Hello."),
        ("Hello. <think>secret", "Hello."),
        ("[THINK]secret[/THINK]Hello.", "Hello."),
        ("Hello.\n<think>secret</think>\nBye.", "Hello.\n\nBye."),
        ("secret</think>", ""),
    ],
)
def test_thinking_is_not_visible(response: str, said: str) -> None:
    """What a response says to others holds nothing of a thinking block, closed or not."""
    assert visible_text(response) == said
