"""``TokenBatch``: rows, masks and turn-level arrays, made from lists of token ids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from gem_core.errors import ArgumentError
from gem_train import TokenBatch
from gem_train.tokens import completions


def three_turns(**options: object) -> TokenBatch:
    """Two turns of episode 0 and one of episode 1."""
    arguments: dict[str, object] = {
        "contexts": [[1, 2], [3], [1, 5]],
        "responses": [[7], [8, 9], [7]],
        "logprobs": [[-1.0], None, [-0.5]],
        "episode": [0, 0, 1],
        "rewards": [0.25, 1.0, 0.5],
        "terminated": [True, False],
    }
    return TokenBatch.from_turns(**{**arguments, **options})  # type: ignore[arg-type]


def test_each_turn_is_a_row() -> None:
    """Context, response, padding; everything of a token beside it."""
    batch = three_turns(pad_id=99)
    assert_array_equal(batch.tokens, [[1, 2, 7], [3, 8, 9], [1, 5, 7]])
    assert_array_equal(three_turns(row=[0, 0, 1], pad_id=99).tokens, [[1, 2, 7, 3, 8, 9], [1, 5, 7, 99, 99, 99]])
    assert_array_equal(batch.token_mask, [[False, False, True], [False, True, True], [False, False, True]])
    assert_array_equal(batch.turn, [[-1, -1, 0], [-1, 1, 1], [-1, -1, 0]])
    assert_array_equal(batch.logprobs, np.array([[0, 0, -1], [0, math.nan, math.nan], [0, 0, -0.5]], np.float32))
    assert_array_equal(batch.episode, [0, 0, 1])
    assert_array_equal(batch.lengths, [3, 3, 3])
    assert_array_equal(batch.rewards, [[0.25, 1.0], [0.5, 0.0]])
    assert_array_equal(batch.mask, [[True, True], [True, False]])
    assert_array_equal(batch.episode_returns, [1.25, 0.5])


def test_turns_are_spread_over_their_tokens() -> None:
    """All of them, or the last one; a wrong shape is refused."""
    batch = three_turns(row=[0, 0, 1])
    assert_array_equal(batch.to_tokens(batch.rewards), [[0, 0, 0.25, 0, 1, 1], [0, 0, 0.5, 0, 0, 0]])
    assert_array_equal(batch.to_last_tokens(batch.rewards), [[0, 0, 0.25, 0, 0, 1], [0, 0, 0.5, 0, 0, 0]])
    with pytest.raises(ArgumentError, match=r"the shape \(2, 2\) of rewards, not \(2, 1\)"):
        batch.to_tokens(batch.rewards[:, :1])


def test_a_long_row_is_cut_off_on_the_right() -> None:
    """The turn that does not fit is not learnable, the earlier one still is; the number is reported."""
    batch = three_turns(row=[0, 0, 1], max_length=5)
    assert_array_equal(batch.tokens, [[1, 2, 7, 3, 8], [1, 5, 7, 0, 0]])
    assert_array_equal(batch.learnable, [[True, False], [True, False]])
    assert_array_equal(batch.loss_mask, [[False, False, True, False, False]] * 2)
    assert batch.too_long == 1
    assert three_turns(row=[0, 0, 1], max_length=6).too_long == 0
    assert three_turns(max_length=2).too_long == 3


def test_a_row_is_a_prompt_and_its_completion() -> None:
    """Only learnable turns have a mask of 1."""
    first, second = completions(three_turns(row=[0, 0, 1], learnable=[True, False, True]))
    assert (first.prompt_ids, first.completion_ids, first.completion_mask) == ([1, 2], [7, 3, 8, 9], [1, 0, 0, 0])
    assert first.logprobs[:2] == [-1.0, 0.0]
    assert np.isnan(first.logprobs[2:]).all()
    assert second == ([1, 5], [7], [1], [-0.5], 1)
    assert completions(three_turns(max_length=2))[0] == ([1, 2], [], [], [], 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"contexts": [[1]]}, "contexts has the length 1, and 3 is needed"),
        ({"logprobs": [None]}, "logprobs has the length 1, and 3 is needed"),
        ({"seats": ["X"]}, "seats has the length 1, and 2 is needed"),
        ({"rewards": [1.0]}, "rewards has the shape (1,), and (3,) is needed"),
        ({"groups": [1]}, "groups has the shape (1,), and (2,) is needed"),
        ({"row": [0, 2, 3]}, "row begins with 0 and is, from turn to turn, the same or one more"),
        ({"row": [1, 2, 3]}, "row begins with 0 and is, from turn to turn, the same or one more"),
        ({"row": [0, 1, 1]}, "a row holds turns of one episode"),
        ({"episode": [0, 0, 2]}, "episode is an index from 0 to 1, one less than the length of terminated"),
        ({"logprobs": [[-1.0], [-1.0], None]}, "turn 1 of the list has 2 tokens and 1 logprobs"),
    ],
)
def test_what_does_not_fit_together_is_refused(options: dict[str, object], message: str) -> None:
    """With the two numbers, or the rule."""
    with pytest.raises(ArgumentError) as caught:
        three_turns(**options)
    assert str(caught.value) == message
