"""The estimators at their edges, their defaults and their gradients; ``test_estimators_properties`` has their sums."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch
from array_kinds import KINDS, Kind, each_kind

from gem_train.estimators import (
    aggregate_tokens,
    discounted_returns,
    gae,
    gigpo_advantages,
    grpo_advantages,
    kl_penalty,
    normalize_advantages,
    policy_gradient_loss,
    ppo_loss,
    return_batch_normalization,
    rloo_advantages,
    role_baselines,
    truncated_importance_weights,
    value_loss,
)

NAN = math.nan


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


HALVES = [Kind("numpy", 16), Kind("torch", 16)]
ORDERS = list(itertools.permutations([0.1, 0.2, 0.3, 0.7]))


@pytest.mark.parametrize("kind", [*KINDS, *HALVES], ids=lambda kind: f"{kind.library}{kind.bits}")
def test_equal_rewards_in_any_order_have_no_advantage(kind: Kind):
    """Exactly: rounding is not blown up by a division by the deviation that it makes."""
    rewards = kind.floats(ORDERS)
    everywhere, same = kind.bools(np.ones((24, 4))), kind.ints([7] * 24)
    totals = rewards.sum(1)
    results = [
        return_batch_normalization(totals[:, None], everywhere[:, :1]),
        return_batch_normalization(totals[:, None], ~everywhere[:, :1]),
        normalize_advantages(totals[:, None], everywhere[:, :1], correction=1),
        grpo_advantages(totals, same),
        rloo_advantages(totals, same),
        gigpo_advantages(rewards, same, kind.ints(np.arange(96).reshape(24, 4)), everywhere, gamma=1.0),
    ]
    assert [np.count_nonzero(np.asarray(result)) for result in results] == [0] * 6


@pytest.mark.parametrize("kind", HALVES, ids=lambda kind: kind.library)
def test_half_precision_is_finite(kind: Kind):
    """An epsilon of 1e-8 is 0 in float16, and so would be the deviation of one; large ratios are no infinity."""
    kind.close(grpo_advantages(kind.floats([0, 0, 1, 1]), kind.ints([0] * 4)), [-1, -1, 1, 1])
    far = kind.floats([[-1, -30]]), kind.floats([[-30, -1]])
    loss, metrics = ppo_loss(*far, kind.floats([[1, -1]]), kind.bools([[1, 1]]))
    assert loss.item() == pytest.approx((-1.2 + 0.8) / 2)
    assert np.isfinite([float(each) for each in metrics]).all()
    assert np.isfinite(np.asarray(kl_penalty(*(each / 2 for each in far), kind.bools([[1, 1]])))).all()
    weights = truncated_importance_weights(*far, kind.bools([[1, 1]]))
    np.testing.assert_allclose(np.asarray(weights), [[2, 0]], rtol=1e-3)


@each_kind
def test_everything_is_learnable_by_default(kind: Kind):
    """The sums of the others, 1 - (3 + 5) / 2 = -3; the deviation of 1, 3, 5 is the root of 8/3."""
    returns, same, mask = kind.floats([1, 3, 5]), kind.ints([8, 8, 8]), kind.bools([[1]] * 3)
    root = math.sqrt(8 / 3)
    expected = [-2 / root, 0, 2 / root]
    kind.close(rloo_advantages(returns, same), [-3, 0, 3])
    kind.close(grpo_advantages(returns, same), expected)
    kind.close(gigpo_advantages(returns[:, None], same, kind.ints([[0], [1], [2]]), mask, gamma=1)[:, 0], expected)
    kind.close(return_batch_normalization(returns[:, None], mask)[:, 0], expected)
    kind.close(normalize_advantages(returns[:, None], mask, correction=1)[:, 0], [-1, 0, 1])


@each_kind
def test_role_baselines(kind: Kind):
    """Each return meets the mean of its role before it moves it, by a twentieth; what was given stays as it was."""
    state = kind.floats([0, 10])
    result = role_baselines(state, kind.floats([4, 6, 4]), kind.ints([0, 1, 0]))
    kind.close(result.advantages, [4, -4, 3.8])
    kind.close(result.baselines, [0.39, 9.8])
    kind.close(state, [0, 10])


@each_kind
def test_truncated_importance_weights(kind: Kind):
    """Ratios 0.5 and 8, the latter cut to 2; 1 where the sampler reported nothing."""
    learner = kind.floats(np.log([[0.2, 0.8, 0.3, 0.3]]))
    sampler = kind.floats([[math.log(0.4), math.log(0.1), NAN, math.log(0.1)]])
    kind.close(truncated_importance_weights(learner, sampler, kind.bools([[1, 1, 1, 0]])), [[0.5, 2, 1, 0]])


# Gradients.

TOKENS = [[True, True, True, False], [False, True, False, False], [False] * 4]


def tensor(values: Any) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def gradients(loss: torch.Tensor, *arguments: torch.Tensor) -> list[Any]:
    """Return the gradient of a loss with respect to each argument; None where none flows."""
    found = torch.autograd.grad(loss.sum(), arguments, allow_unused=True)
    return [None if each is None else each.tolist() for each in found]


def test_gradients_flow_through_what_is_learnt_alone():
    """Nothing into advantages, weights, targets, references or masked tokens, NaN or not."""
    rewards = tensor([[1, 1, 1]])
    assert gradients(discounted_returns(rewards, rewards > 0, gamma=0.5)[0, 0], rewards) == [[[1, 0.5, 0.25]]]

    logprobs = tensor([[-2, -1, -3, NAN], [NAN, -4, NAN, NAN], [NAN] * 4])
    old, advantages, weights = (tensor(np.full((3, 4), 2.0)) for _ in range(3))
    loss, _ = policy_gradient_loss(logprobs, old, advantages, torch.tensor(TOKENS), weights=weights)
    learnt = [[-1, -1, -1, 0], [0, -1, 0, 0], [0, 0, 0, 0]]  # minus advantage times weight, over 4 tokens
    assert gradients(loss, logprobs, old, advantages, weights) == [learnt, None, None, None]

    values, targets = tensor([[1, 2, NAN]]), tensor([[2, 5, NAN]])
    loss = value_loss(values, targets, torch.tensor([[True, True, False]]))
    assert gradients(loss, values, targets) == [[[-0.5, -1.5, 0]], None]

    for kind, slope in (("k1", 1.0), ("k2", -math.log(2)), ("k3", 1 - 2.0)):
        logprobs, reference = tensor([[-1, NAN]]), tensor([[math.log(2) - 1, 0]])
        penalty = kl_penalty(logprobs, reference, torch.tensor([[True, False]]), kind=kind)  # type: ignore[arg-type]
        assert gradients(penalty, logprobs, reference) == [[[pytest.approx(slope), 0]], None]


def test_a_clipped_ratio_has_no_gradient():
    """Ratios 0.5, 1.1, one that would overflow, and 2 against a negative advantage: minus ratio times advantage."""
    logprobs = tensor(np.log([[0.5, 1.1, 1.0, 2.0]]) + np.array([[0, 0, 1000, 0]]))
    old, advantages = tensor([[0.0] * 4]), tensor([[1.0, 2.0, 1.0, -1.0]])
    loss, metrics = ppo_loss(logprobs, old, advantages, torch.ones(1, 4, dtype=torch.bool))
    learnt = [[pytest.approx(each) for each in (-0.5 / 4, -2.2 / 4, 0, 2 / 4)]]
    assert gradients(loss, logprobs, old, advantages) == [learnt, None, None]
    assert metrics.clip_fraction == 1 / 4


@pytest.mark.parametrize("aggregate", ["token", "sequence", "constant"])
def test_everything_masked_gives_zero_with_gradient_zero(aggregate: Any):
    """No NaN, whatever stands in the arrays."""
    nothing = torch.zeros(2, 3, dtype=torch.bool)
    junk = torch.full((2, 3), NAN, dtype=torch.float64)
    options: dict[str, Any] = {"aggregate": aggregate, "length": 8 if aggregate == "constant" else None}
    for function in (policy_gradient_loss, ppo_loss):
        logprobs = tensor([[NAN] * 3, [math.inf] * 3])
        loss, metrics = function(logprobs, junk, junk, nothing, weights=junk, **options)
        assert (loss.item(), any(metrics)) == (0, False)
        assert gradients(loss, logprobs) == [[[0] * 3] * 2]
    values = tensor([[NAN] * 3] * 2)
    assert gradients(value_loss(values, junk, nothing), values) == [[[0] * 3] * 2]


ONES = np.ones((2, 3))
MASK = ONES > 0


@pytest.mark.parametrize(
    ("call", "value"),
    [
        (lambda: discounted_returns(ONES, np.ones((2, 2), dtype=bool), gamma=0.9), r"mask .*\(2, 2\).*\(2, 3\)"),
        (lambda: discounted_returns(ONES, ONES, gamma=0.9), "mask .*float64.*bool"),
        (lambda: discounted_returns(ONES, MASK, gamma=NAN), "gamma is nan"),
        (lambda: discounted_returns(ONES, MASK, gamma=1, terminated=MASK[:, 0]), "bootstrap_values"),
        (lambda: gae(ONES, ONES, MASK, MASK[:, 0], ONES[:, 0], gamma=1, lam=-1), "lam is -1"),
        (lambda: grpo_advantages(np.array([1, 0]), np.array([1, 1])), "episode_returns .*int64"),
        (lambda: grpo_advantages(ONES[0], np.array([1, 1, 1]), scale="mean"), "'mean'"),  # type: ignore[arg-type]
        (lambda: role_baselines(ONES[0], ONES[0], np.array([0, 1, 3])), "roles has 3"),
        (lambda: ppo_loss(ONES, ONES[:1], ONES, MASK), r"old_logprobs .*\(1, 3\).*\(2, 3\)"),
        (lambda: ppo_loss(ONES, ONES, ONES, MASK, clip_low=2), "clip_low is 2"),
        (lambda: aggregate_tokens(ONES, MASK, aggregate="mean"), "'mean'"),  # type: ignore[arg-type]
        (lambda: aggregate_tokens(ONES, MASK, aggregate="constant"), "length"),
        (lambda: kl_penalty(ONES, ONES, MASK, kind="k4"), "'k4'"),  # type: ignore[arg-type]
        (lambda: truncated_importance_weights(ONES, ONES, MASK, cap=0), "cap is 0"),
    ],
)
def test_what_cannot_be_right_is_an_error(call: Any, value: str):
    """The message names the argument and what was given."""
    with pytest.raises(ValueError, match=value):
        call()
