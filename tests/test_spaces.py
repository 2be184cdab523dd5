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
def test_samples_follow_the_seed_and_are_contained(space: type[Text]) -> None:
    """Every sample belongs to its space, and depends on the seed alone; Gymnasium batches them."""
    first, second = space(seed=3), space(seed=3)
    samples = [first.sample() for _ in range(100)]
    assert samples == [second.sample() for _ in range(100)]
    assert all(sample in first for sample in samples)
    assert batch_space(space(), 2).contains((space().sample(), space().sample()))


def test_equal_by_kind() -> None:
    """Two spaces of one kind are equal, whatever their seeds, and have one hash; of two kinds they differ."""
    assert [a(seed=1) == b(seed=2) for a in SPACES for b in SPACES] == [a is b for a in SPACES for b in SPACES]
    for space in SPACES:
        assert len({space(), copy.deepcopy(space()), pickle.loads(pickle.dumps(space(seed=1)))}) == 1


@pytest.mark.parametrize(
    ("space", "value", "inside"),
    [
        *((space, text, True) for space in (Text, Content) for text in ("", "x" * 10**6, "\x00", "\ud800", "中🙂")),
        *((Text, other, False) for other in (None, b"x", ["x"])),
        (Content, [], True),
        (Content, [{"type": "text", "text": "x"}, IMAGE], True),
        *((Content, [part], False) for part in ({"type": "text"}, {"type": "text", "text": 1}, {"type": "image"}, "x")),
        *(
            (Content, other, False)
            for other in (b"x", {"type": "text", "text": "x"}, [{"type": "sound", "sound": b""}])
        ),
        (Messages, [{"role": "user", "content": "x"}], True),
        *((Messages, other, False) for other in ([{"content": "x"}], "x", [1])),
    ],
)
def test_what_a_space_contains(space: type[Text], value: Any, inside: bool) -> None:
    """Any string at all; parts with what their type says; mappings with a role."""
    assert (value in space()) is inside
