"""Returns and advantages at their edges and with their defaults; ``test_estimators_properties`` has their sums."""

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


@each_kind
def test_every_episode_is_learnable_by_default(kind: Kind):
    """The sums of the others, 1 - (3 + 5) / 2 = -3; the deviation of 1, 3, 5 is the root of 8/3."""
    returns, same = kind.floats([1, 3, 5]), kind.ints([8, 8, 8])
    root = math.sqrt(8 / 3)
    kind.close(rloo_advantages(returns, same), [-3, 0, 3])
    kind.close(grpo_advantages(returns, same), [-2 / root, 0, 2 / root])
    kind.close(role_baselines(kind.floats([10]), returns[:1], same[:1] - 8).advantages, [-9])


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
    ("call", "value"),
    [
        (lambda: discounted_returns(ONES, np.ones((2, 2), dtype=bool), gamma=0.9), r"mask .*\(2, 2\).*\(2, 3\)"),
        (lambda: discounted_returns(ONES[0], ONES > 0, gamma=0.9), r"rewards .*\(3,\)"),
        (lambda: discounted_returns(ONES, ONES, gamma=0.9), "mask .*float64.*bool"),
        (lambda: discounted_returns(ONES, ONES > 0, gamma=1.1), r"gamma is 1\.1"),
        (lambda: discounted_returns(ONES, ONES > 0, gamma=NAN), "gamma is nan"),
        (lambda: discounted_returns(ONES, ONES > 0, gamma=1, terminated=ONES[:, 0] > 0), "bootstrap_values"),
        (lambda: gae(ONES, ONES, ONES > 0, ONES[:, 0] > 0, ONES[:, 0], gamma=1, lam=-1), "lam is -1"),
        (lambda: grpo_advantages(np.array([1, 0]), np.array([1, 1])), "episode_returns .*int64"),
        (lambda: grpo_advantages(ONES[0], np.array([1, 1, 1]), scale="mean"), "'mean'"),  # type: ignore[arg-type]
        (lambda: role_baselines(ONES[0], ONES[0], np.array([0, 1, 3])), "roles has 3"),
    ],
)
def test_what_cannot_be_right_is_an_error(call, value: str):
    """The message names the argument and what was given."""
    with pytest.raises(ValueError, match=value):
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
