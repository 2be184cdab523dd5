"""The spaces of text, content parts and messages."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest
from gymnasium.vector.utils import batch_space

from gem_core.env.spaces import Content, Messages, Text

SPACES = [Text, Content, Messages]
IMAGE = {"type": "image", "image": object()}


@pytest.mark.parametrize("space", SPACES)
def test_samples_are_contained(space: type[Text]) -> None:
    """Every sample belongs to its space."""
    made = space(seed=1)
    assert all(made.sample() in made for _ in range(200))


@pytest.mark.parametrize("space", SPACES)
def test_same_seed_same_samples(space: type[Text]) -> None:
    """Samples depend on the seed alone."""
    first, second = space(seed=3), space(seed=3)
    assert [first.sample() for _ in range(20)] == [second.sample() for _ in range(20)]


@pytest.mark.parametrize("space", SPACES)
def test_equal_by_value(space: type[Text]) -> None:
    """Two spaces of one kind are equal, whatever their seeds, and have one hash."""
    assert space(seed=1) == space(seed=2)
    assert len({space(), copy.deepcopy(space()), pickle.loads(pickle.dumps(space(seed=1)))}) == 1


def test_kinds_are_not_equal() -> None:
    """Spaces of different kinds differ, in both directions."""
    assert [a() == b() for a in SPACES for b in SPACES] == [a is b for a in SPACES for b in SPACES]


@pytest.mark.parametrize("text", ["", "x" * 1_000_000, "\x00", "\ud800", "中🙂"])
def test_any_text_is_contained(text: str) -> None:
    """Text takes any string at all."""
    assert text in Text()
    assert text in Content()


@pytest.mark.parametrize("other", [None, 1, b"x", ["x"], {}])
def test_other_things_are_not_text(other: Any) -> None:
    """What is no string is no text."""
    assert other not in Text()


@pytest.mark.parametrize(
    ("value", "inside"),
    [
        ([], True),
        ([{"type": "text", "text": "x"}, IMAGE], True),
        ([{"type": "text"}], False),
        ([{"type": "text", "text": 1}], False),
        ([{"type": "image"}], False),
        ([{"type": "sound", "sound": b""}], False),
        (["x"], False),
        (b"x", False),
        ({"type": "text", "text": "x"}, False),
    ],
)
def test_content_takes_parts(value: Any, inside: bool) -> None:
    """Content takes lists of text and image parts, each with what its type says."""
    assert (value in Content()) is inside


@pytest.mark.parametrize(
    ("value", "inside"),
    [([{"role": "user", "content": "x"}], True), ([{"content": "x"}], False), ("x", False), ([1], False)],
)
def test_messages_take_roles(value: Any, inside: bool) -> None:
    """Messages are a list of mappings with a role."""
    assert (value in Messages()) is inside


@pytest.mark.parametrize("space", SPACES)
def test_gymnasium_batches_them(space: type[Text]) -> None:
    """Gymnasium's vector utilities make a tuple of one space for each environment."""
    assert batch_space(space(), 2).contains((space().sample(), space().sample()))
