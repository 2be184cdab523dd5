"""Returns and advantages, against values worked by hand, and at their edges."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from array_kinds import Kind, each_kind

from gem_train.estimators import (
    discounted_returns,
    gae,
    gigpo_advantages,
    grpo_advantages,
    learnable_turns,
    normalize_advantages,
    return_batch_normalization,
    rloo_advantages,
    role_baselines,
)

NAN = math.nan
MASK = [[True, True, True], [True, True, False], [False, False, False]]
"""Three turns, two, none."""


def test_estimators_import_neither_torch_nor_the_core():
    """NumPy alone is enough, and nothing else is loaded."""
    code = (
        "import json, sys, numpy as np\nfrom gem_train.estimators import grpo_advantages, ppo_loss\n"
        "ones = np.ones((1, 2))\nppo_loss(ones, ones, ones, ones > 0)\n"
        "grpo_advantages(ones[0], np.array([1, 1]))\n"
        "print(json.dumps(sorted(name for name in ('torch', 'gem_core') if name in sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout) == []


@each_kind
def test_discounted_returns(kind: Kind):
    """4 = 0 + 0.5 * (0 + 0.5 * 16) and so on; padding counts for nothing, an episode without turns has zeros."""
    rewards = kind.floats([[0, 0, 16], [1, 2, NAN], [NAN, NAN, NAN]])
    result = discounted_returns(rewards, kind.bools(MASK), gamma=0.5)
    kind.close(result, [[4, 8, 16], [2, 2, 0], [0, 0, 0]])


@each_kind
def test_discounted_returns_at_the_ends_of_gamma(kind: Kind):
    """0 leaves the rewards, 1 sums them."""
    rewards, mask = kind.floats([[1, 2, 3]]), kind.bools([[True] * 3])
    kind.close(discounted_returns(rewards, mask, gamma=0), [[1, 2, 3]])
    kind.close(discounted_returns(rewards, mask, gamma=1), [[6, 5, 3]])


@each_kind
def test_discounted_returns_bootstrap_only_what_did_not_terminate(kind: Kind):
    """The second episode was cut off at a value of 10: 7 = 2 + 0.5 * 10."""
    result = discounted_returns(
        kind.floats([[0, 0, 16], [1, 2, 0], [0, 0, 0]]),
        kind.bools(MASK),
        gamma=0.5,
        terminated=kind.bools([True, False, False]),
        bootstrap_values=kind.floats([NAN, 10, 3]),
    )
    kind.close(result, [[4, 8, 16], [4.5, 7, 0], [0, 0, 0]])


@each_kind
def test_no_turns_at_all(kind: Kind):
    """Episodes without turns, and no episodes, give empty arrays."""
    for shape in ((2, 0), (0, 3)):
        empty, mask = kind.floats(np.zeros(shape)), kind.bools(np.zeros(shape))
        ends = kind.bools(np.zeros(shape[0])), kind.floats(np.zeros(shape[0]))
        ids = kind.ints(np.zeros(shape[0])), kind.ints(np.zeros(shape))
        kind.close(discounted_returns(empty, mask, gamma=0.9), np.zeros(shape))
        kind.close(gae(empty, empty, mask, *ends, gamma=0.9, lam=0.9)[1], np.zeros(shape))
        kind.close(return_batch_normalization(empty, mask), np.zeros(shape))
        kind.close(gigpo_advantages(empty, *ids, mask, gamma=0.9), np.zeros(shape))


@each_kind
def test_gae(kind: Kind):
    """With gamma and lam 0.5; the first episode terminates, the second is cut off at a value of 8.

    First: δ₂ = 4 - 1 = 3; δ₁ = 0 + 0.5 * 1 - 2 = -1.5, A₁ = -1.5 + 0.25 * 3 = -0.75; δ₀ = 1 + 0.5 * 2 - 3 = -1,
    A₀ = -1 - 0.25 * 0.75 = -1.1875. Second: δ₁ = 0 + 0.5 * 8 - 2 = 2; δ₀ = 1 + 0.5 * 2 - 1 = 1, A₀ = 1.5.
    """
    advantages, targets = gae(
        kind.floats([[1, 0, 4], [1, 0, NAN], [NAN, NAN, NAN]]),
        kind.floats([[3, 2, 1], [1, 2, NAN], [NAN, NAN, NAN]]),
        kind.bools(MASK),
        kind.bools([True, False, False]),
        kind.floats([NAN, 8, 5]),
        gamma=0.5,
        lam=0.5,
    )
    kind.close(advantages, [[-1.1875, -0.75, 3], [1.5, 2, 0], [0, 0, 0]])
    kind.close(targets, [[1.8125, 1.25, 4], [2.5, 4, 0], [0, 0, 0]])


@each_kind
def test_return_batch_normalization(kind: Kind):
    """Of 1, 3, 5, 7 the mean is 4 and the deviation the root of 5; the turn that is masked counts for nothing."""
    result = return_batch_normalization(kind.floats([[1, 3], [5, 7], [NAN, 9]]), kind.bools([[1, 1], [1, 1], [0, 0]]))
    root = math.sqrt(5)
    kind.close(result, [[-3 / root, -1 / root], [1 / root, 3 / root], [0, 0]])


@each_kind
def test_normalize_advantages_with_the_deviation_of_torch(kind: Kind):
    """``correction=1`` divides the squares, 20, by 3."""
    result = normalize_advantages(kind.floats([[1, 3], [5, 7]]), kind.bools([[1, 1], [1, 1]]), correction=1)
    root = math.sqrt(20 / 3)
    kind.close(result, [[-3 / root, -1 / root], [1 / root, 3 / root]])


@each_kind
@pytest.mark.parametrize("correction", [0, 1])
def test_equal_returns_have_no_advantage(kind: Kind, correction: int):
    """Not even by rounding: three times 0.1 has a mean that is not 0.1."""
    equal = kind.floats([[0.1, 0.1, 0.1]])
    everywhere, once = kind.bools([[1, 1, 1]]), kind.bools([[0, 1, 0]])
    same = kind.ints([7, 7, 7])
    for result in (
        return_batch_normalization(equal, everywhere, correction=correction),
        return_batch_normalization(equal, once, correction=correction),
        return_batch_normalization(equal, ~everywhere, correction=correction),
        grpo_advantages(equal[0], same, correction=correction),
        rloo_advantages(equal[0], same),
        gigpo_advantages(equal, same[:1], kind.ints([[1, 1, 1]]), everywhere, gamma=0, correction=correction),
    ):
        assert not np.any(np.asarray(result))


RETURNS = [1, 3, 5, 2, 4, 9, NAN]
GROUPS = [8, 8, 8, -1, -1, 3, 8]
NO_ERROR = [True] * 6 + [False]
"""A group of three and one that failed, a group of two, a group of one."""


@each_kind
def test_grpo_advantages(kind: Kind):
    """Of 1, 3, 5 the deviation is the root of 8/3; the episode with an error is left out and gets 0."""
    result = grpo_advantages(kind.floats(RETURNS), kind.ints(GROUPS), learnable=kind.bools(NO_ERROR))
    root = math.sqrt(8 / 3)
    kind.close(result, [-2 / root, 0, 2 / root, -1, 1, 0, 0])


@each_kind
def test_grpo_advantages_without_the_deviation(kind: Kind):
    """Dr. GRPO subtracts the mean alone."""
    result = grpo_advantages(kind.floats(RETURNS), kind.ints(GROUPS), scale="none", learnable=kind.bools(NO_ERROR))
    kind.close(result, [-2, 0, 2, -1, 1, 0, 0])


@each_kind
def test_rloo_advantages(kind: Kind):
    """1 - (3 + 5) / 2 = -3; a group of one has nothing to compare with."""
    result = rloo_advantages(kind.floats(RETURNS), kind.ints(GROUPS), learnable=kind.bools(NO_ERROR))
    kind.close(result, [-3, 0, 3, -2, 2, 0, 0])


@each_kind
def test_groups_without_a_learnable_episode_are_zero(kind: Kind):
    """All failed: no NaN."""
    nothing = kind.bools([False, False])
    for function in (grpo_advantages, rloo_advantages):
        kind.close(function(kind.floats([NAN, 1]), kind.ints([1, 1]), learnable=nothing), [0, 0])


@each_kind
def test_gigpo_advantages(kind: Kind):
    """Two episodes of one group pass through states 1, 2 and 1, 3, 1; another group's state 1 is not theirs.

    Totals 4 and 2: ±1. Returns at gamma 0.5: (2, 4) and (0.5, 1, 2). In state 1: 2, 0.5, 2, mean 1.5.
    """
    arguments = (
        kind.floats([[0, 4, NAN], [0, 0, 2], [3, NAN, NAN]]),
        kind.ints([5, 5, 6]),
        kind.ints([[1, 2, 0], [1, 3, 1], [1, 0, 0]]),
        kind.bools([[1, 1, 0], [1, 1, 1], [1, 0, 0]]),
    )
    result = gigpo_advantages(*arguments, gamma=0.5, scale="none")
    kind.close(result, [[1.5, 1, 0], [-2, -1, -0.5], [0, 0, 0]])
    result = gigpo_advantages(*arguments, gamma=0.5, step_weight=2)
    half = 0.5 / math.sqrt(0.5)  # (0.25 + 1 + 0.25) / 3 = 0.5
    kind.close(result, [[1 + 2 * half, 1, 0], [-1 - 4 * half, -1, -1 + 2 * half], [0, 0, 0]])


@each_kind
def test_gigpo_leaves_out_what_cannot_be_learnt_from(kind: Kind):
    """An idle turn leaves its state's group; an episode that failed leaves both."""
    result = gigpo_advantages(
        kind.floats([[0, 4], [0, 2], [0, 90]]),
        kind.ints([5, 5, 5]),
        kind.ints([[1, 1], [1, 1], [1, 1]]),
        kind.bools([[1, 1], [1, 1], [1, 1]]),
        gamma=1,
        scale="none",
        learnable=kind.bools([[1, 1], [0, 1], [0, 0]]),
    )
    # Totals 4 and 2; in state 1: 4, 4 and 2, mean 10/3.
    kind.close(result, [[1 + 2 / 3, 1 + 2 / 3], [0, -1 - 4 / 3], [0, 0]])


@each_kind
def test_learnable_turns(kind: Kind):
    """An error takes the whole episode, an idle turn and a cut-off response themselves."""
    result = learnable_turns(
        kind.bools([[1, 1, 1], [1, 1, 0], [1, 1, 1]]),
        error=kind.bools([0, 0, 1]),
        idle=kind.bools([[0, 1, 0], [0, 0, 0], [0, 0, 0]]),
        cut_off=kind.bools([[0, 0, 0], [0, 1, 0], [0, 0, 0]]),
    )
    assert result.tolist() == [[True, False, True], [True, False, False], [False, False, False]]


@each_kind
def test_role_baselines(kind: Kind):
    """Each return meets the mean of its role before it moves it; an error moves nothing; the state stays as it was."""
    state = kind.floats([0, 10])
    result = role_baselines(
        state,
        kind.floats([4, 6, 4, NAN]),
        kind.ints([0, 1, 0, 1]),
        decay=0.5,
        learnable=kind.bools([1, 1, 1, 0]),
    )
    kind.close(result.advantages, [4, -4, 2, 0])
    kind.close(result.baselines, [3, 8])
    kind.close(state, [0, 10])


ONES = np.ones((2, 3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: discounted_returns(ONES, np.ones((2, 2), dtype=bool), gamma=0.9),
            r"mask has the shape \(2, 2\); expected \(2, 3\)",
        ),
        (
            lambda: discounted_returns(ONES[0], ONES > 0, gamma=0.9),
            r"rewards has the shape \(3,\); expected \(any, any\)",
        ),
        (lambda: discounted_returns(ONES, ONES, gamma=0.9), "mask has the dtype float64; expected bool"),
        (lambda: discounted_returns(ONES, ONES > 0, gamma=1.1), "gamma is 1.1; expected a number from 0 to 1"),
        (lambda: discounted_returns(ONES, ONES > 0, gamma=NAN), "gamma is nan; expected a number from 0 to 1"),
        (
            lambda: discounted_returns(ONES, ONES > 0, gamma=1, terminated=ONES[:, 0] > 0),
            "terminated and bootstrap_values belong together; give both or neither",
        ),
        (
            lambda: gae(ONES, ONES, ONES > 0, ONES[:, 0] > 0, ONES[:, 0], gamma=1, lam=-1),
            "lam is -1; expected a number from 0 to 1",
        ),
        (
            lambda: grpo_advantages(np.array([1, 0]), np.array([1, 1])),
            "episode_returns has the dtype int64; expected float",
        ),
        (
            lambda: grpo_advantages(ONES[0], np.array([1, 1, 1]), scale="mean"),
            "scale is 'mean'; expected 'std' or 'none'",
        ),
        (
            lambda: role_baselines(ONES[0], ONES[0], np.array([0, 1, 3])),
            "roles has 3; expected an index of the 3 baselines, 0 to 2",
        ),
    ],
)
def test_what_cannot_be_right_is_an_error(call, message: str):
    """The message says what was given and what was expected."""
    with pytest.raises(ValueError, match=f"^{message}$"):
        call()


def test_gradients_flow_through_returns():
    """In torch, the derivative of the first return by the rewards is 1, 0.5, 0.25."""
    rewards = torch.ones(1, 3, dtype=torch.float64, requires_grad=True)
    discounted_returns(rewards, torch.ones(1, 3, dtype=torch.bool), gamma=0.5)[0, 0].backward()
    assert rewards.grad is not None
    assert rewards.grad.tolist() == [[1, 0.5, 0.25]]


def test_a_large_batch_keeps_the_precision_of_its_dtype():
    """200,000 returns around 100 in float32, as exact as in float64 but for the last digits."""
    returns = np.random.default_rng(0).normal(100, 1, size=(10_000, 20)).astype(np.float32)
    mask = np.ones(returns.shape, dtype=bool)
    exact = return_batch_normalization(returns.astype(np.float64), mask)
    np.testing.assert_allclose(return_batch_normalization(returns, mask), exact, atol=5e-5)
    tensors = torch.from_numpy(returns), torch.from_numpy(mask)
    np.testing.assert_allclose(return_batch_normalization(*tensors), exact, atol=5e-5)
