"""Losses and what is measured on tokens, against values and gradients worked by hand, and at their edges."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from array_kinds import Kind, each_kind

from gem_train.estimators import (
    aggregate_tokens,
    entropy,
    kl_penalty,
    policy_gradient_loss,
    ppo_loss,
    truncated_importance_weights,
    value_loss,
)

NAN = math.nan
TOKENS = [[1, 1, 1, 0], [0, 1, 0, 0], [0, 0, 0, 0]]
"""Three sampled tokens, one, none."""
AGGREGATES: list[dict[str, Any]] = [
    {"aggregate": "token"},
    {"aggregate": "sequence"},
    {"aggregate": "constant", "length": 8},
]
RATIOS = [[0.5, 1.1, 1.5, 7], [7, 2.0, 7, 7], [7, 7, 7, 7]]
ADVANTAGES = [[1, 2, 1, 7], [7, -1, 7, 7], [7, 7, 7, 7]]


def tensor(values: Any, *, grad: bool = False) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64, requires_grad=grad)


@each_kind
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"aggregate": "token"}, (1 + 2 + 6 + 5) / 4),
        ({"aggregate": "sequence"}, (3 + 5) / 2),
        ({"aggregate": "constant", "length": 8}, (9 / 8 + 5 / 8) / 2),
        ({"aggregate": "token", "denominator": 10}, 14 / 10),
        ({"aggregate": "sequence", "denominator": 10}, 8 / 10),
        ({"aggregate": "constant", "length": 8, "denominator": 10}, (14 / 8) / 10),
    ],
)
def test_aggregate_tokens(kind: Kind, options: dict[str, Any], expected: float):
    """A row without a sampled token does not count."""
    values = kind.floats([[1, 2, 6, NAN], [NAN, 5, NAN, NAN], [NAN] * 4])
    kind.close(aggregate_tokens(values, kind.bools(TOKENS), **options), expected)


@each_kind
def test_policy_gradient_loss(kind: Kind):
    """The mean of 2, 2, 9 and, weighed by a half, -4: minus advantage times log-probability."""
    logprobs = kind.floats([[-2, -1, -3, NAN], [NAN, -4, NAN, NAN], [NAN] * 4])
    advantages = kind.floats([[1, 2, 3, NAN], [NAN, -1, NAN, NAN], [NAN] * 4])
    weights = kind.floats([[1, 1, 1, NAN], [NAN, 0.5, NAN, NAN], [NAN] * 4])
    mask = kind.bools(TOKENS)
    kind.close(policy_gradient_loss(logprobs, logprobs, advantages, mask)[0], (2 + 2 + 9 - 4) / 4)
    loss, metrics = policy_gradient_loss(logprobs, logprobs, advantages, mask, weights=weights)
    kind.close(loss, (2 + 2 + 9 - 2) / 4)
    for value, expected in zip(metrics, (1, 0, 0), strict=True):
        kind.close(value, expected)


@each_kind
def test_ppo_loss(kind: Kind):
    """Ratios 0.5, 1.1, 1.5 meet advantages 1, 2, 1: 0.5, 2.2, and 1.2 for 1.5; 2 meets -1, and is not clipped."""
    old = kind.floats(np.full((3, 4), -1.0))
    mask = kind.bools(TOKENS)
    loss, metrics = ppo_loss(old + kind.floats(np.log(RATIOS)), old, kind.floats(ADVANTAGES), mask)
    kind.close(loss, -(0.5 + 2.2 + 1.2 - 2) / 4)
    kind.close(metrics.ratio, (0.5 + 1.1 + 1.5 + 2) / 4)
    kind.close(metrics.approximate_kl, (5.1 - 4 - math.log(0.5 * 1.1 * 1.5 * 2)) / 4)
    kind.close(metrics.clip_fraction, 1 / 4)


@each_kind
@pytest.mark.parametrize(
    ("options", "kept", "clipped"),
    [
        ({"clip_high": 0.6}, (0.5, 2.2, 1.5, -2), 0),
        ({"clip_high": 0.05}, (0.5, 2.1, 1.05, -2), 2),
        ({"dual_clip": 1.7}, (0.5, 2.2, 1.2, -1.7), 2),
        ({"dual_clip": 3}, (0.5, 2.2, 1.2, -2), 1),
    ],
)
def test_ppo_clips_as_far_as_asked(kind: Kind, options: dict[str, float], kept: tuple[float, ...], clipped: int):
    """Clip-higher lets a ratio of 1.5 through; a dual clip bounds the ratio of 2 against a negative advantage."""
    logprobs, zeros = kind.floats(np.log(RATIOS)), kind.floats(np.zeros((3, 4)))
    loss, metrics = ppo_loss(logprobs, zeros, kind.floats(ADVANTAGES), kind.bools(TOKENS), **options)
    kind.close(loss, -sum(kept) / 4)
    kind.close(metrics.clip_fraction, clipped / 4)


@each_kind
def test_kl_estimators_agree_with_the_divergence(kind: Kind):
    """Weighed by the policy's probabilities 0.5, 0.25, 0.25, k1 and k3 are the divergence from 0.25, 0.25, 0.5."""
    policy, reference = np.array([0.5, 0.25, 0.25]), np.array([0.25, 0.25, 0.5])
    arguments = kind.floats([np.log(policy)]), kind.floats([np.log(reference)]), kind.bools([[1, 1, 1]])
    for name in ("k1", "k3"):
        estimate = np.asarray(kl_penalty(*arguments, kind=name))[0] @ policy
        assert estimate == pytest.approx(0.25 * math.log(2), rel=1e-5)
    kind.close(kl_penalty(*arguments), np.asarray(kl_penalty(*arguments, kind="k3")))


@each_kind
def test_truncated_importance_weights(kind: Kind):
    """Ratios 0.5 and 8, the latter cut to 2; 1 where the sampler reported nothing."""
    learner = kind.floats(np.log([[0.2, 0.8, 0.3, 0.3]]))
    sampler = kind.floats([[math.log(0.4), math.log(0.1), NAN, math.log(0.1)]])
    weights = truncated_importance_weights(learner, sampler, kind.bools([[1, 1, 1, 0]]))
    kind.close(weights, [[0.5, 2, 1, 0]])
    kind.close(truncated_importance_weights(learner, sampler, kind.bools([[1, 1, 1, 0]]), cap=10), [[0.5, 8, 1, 0]])


@each_kind
def test_entropy(kind: Kind):
    """Two even choices have log 2, a third that is impossible adds nothing; large logits do not overflow."""
    logits = kind.floats([[[900, 900, -math.inf], [math.log(2), 0, 0], [NAN, NAN, NAN]]])
    kind.close(entropy(logits, kind.bools([[1, 1, 0]])), [[math.log(2), 1.5 * math.log(2), 0]])


@pytest.mark.parametrize("options", AGGREGATES)
def test_everything_masked_gives_zero_with_gradient_zero(options: dict[str, Any]):
    """No NaN, whatever stands in the arrays."""
    nothing = torch.zeros(2, 3, dtype=torch.bool)
    junk = torch.full((2, 3), NAN, dtype=torch.float64)
    for function in (policy_gradient_loss, ppo_loss):
        logprobs = tensor([[NAN] * 3, [math.inf] * 3], grad=True)
        loss, metrics = function(logprobs, junk, junk, nothing, weights=junk, **options)
        loss.backward()
        assert loss.item() == 0
        assert not any(metrics)
        assert logprobs.grad is not None
        assert not logprobs.grad.any()
    values = tensor([[NAN] * 3] * 2, grad=True)
    for options in ({}, {"old_values": junk, "clip": 1.0}):
        loss = value_loss(values, junk, nothing, **options)
        loss.backward()
        assert loss.item() == 0
        assert values.grad is not None
        assert not values.grad.any()


def test_gradient_of_the_policy_gradient_loss():
    """Of each sampled token minus advantage times weight over 4 tokens; nothing flows into the other arguments."""
    logprobs = tensor([[-2, -1, -3, NAN], [NAN, -4, NAN, NAN], [NAN] * 4], grad=True)
    others = [tensor(np.full((3, 4), 2.0), grad=True) for _ in range(3)]
    loss, _ = policy_gradient_loss(logprobs, others[0], others[1], torch.tensor(TOKENS).bool(), weights=others[2])
    loss.backward()
    assert logprobs.grad is not None
    assert logprobs.grad.tolist() == [[-1, -1, -1, 0], [0, -1, 0, 0], [0, 0, 0, 0]]
    assert all(other.grad is None for other in others)


def test_gradient_of_the_ppo_loss():
    """Minus ratio times advantage over 4 tokens, and 0 where the ratio is clipped, even one that would overflow."""
    logprobs = tensor(np.log(RATIOS), grad=True)
    with torch.no_grad():
        logprobs[0, 2] = 1000.0
    old, advantages = tensor(np.zeros((3, 4)), grad=True), tensor(ADVANTAGES, grad=True)
    ppo_loss(logprobs, old, advantages, torch.tensor(TOKENS).bool())[0].backward()
    assert logprobs.grad is not None
    expected = [[-0.5 / 4, -2.2 / 4, 0, 0], [0, 2 / 4, 0, 0], [0, 0, 0, 0]]
    np.testing.assert_allclose(logprobs.grad.numpy(), expected)
    assert old.grad is None
    assert advantages.grad is None


def test_gradient_of_the_value_loss():
    """Value minus target over the number of turns; targets are constants."""
    values, targets = tensor([[1, 2, NAN]], grad=True), tensor([[2, 5, NAN]], grad=True)
    value_loss(values, targets, torch.tensor([[True, True, False]])).backward()
    assert values.grad is not None
    assert values.grad.tolist() == [[-0.5, -1.5, 0]]
    assert targets.grad is None


def test_gradient_of_the_entropy():
    """For two choices with p = 0.75, p (1 - p) (log(1 - p) - log p); for an impossible one 0."""
    logits = tensor([[[math.log(3), 0, -math.inf], [NAN] * 3]], grad=True)
    entropy(logits, torch.tensor([[True, False]])).sum().backward()
    slope = 0.75 * 0.25 * math.log(3)
    assert logits.grad is not None
    np.testing.assert_allclose(logits.grad.numpy(), [[[-slope, slope, 0], [0, 0, 0]]], atol=1e-12)


def test_gradient_of_the_divergence():
    """k1: 1; k2: the log-ratio of policy to reference; k3: 1 - r. None at masked tokens or to the reference."""
    expected = {"k1": 1.0, "k2": -math.log(2), "k3": 1 - 2.0}
    for kind, slope in expected.items():
        logprobs, reference = tensor([[-1, NAN]], grad=True), tensor([[math.log(2) - 1, 0]], grad=True)
        kl_penalty(logprobs, reference, torch.tensor([[True, False]]), kind=kind).sum().backward()  # type: ignore[arg-type]
        assert logprobs.grad is not None
        np.testing.assert_allclose(logprobs.grad.numpy(), [[slope, 0]])
        assert reference.grad is None


ONES = np.ones((2, 3))
MASK = ONES > 0


@pytest.mark.parametrize(
    ("call", "value"),
    [
        (lambda: ppo_loss(ONES, ONES[:1], ONES, MASK), r"old_logprobs .*\(1, 3\).*\(2, 3\)"),
        (lambda: ppo_loss(ONES, ONES, ONES, MASK, clip_low=2), "clip_low is 2"),
        (lambda: ppo_loss(ONES, ONES, ONES, MASK, dual_clip=1), "dual_clip is 1"),
        (lambda: aggregate_tokens(ONES, MASK, aggregate="mean"), "'mean'"),  # type: ignore[arg-type]
        (lambda: aggregate_tokens(ONES, MASK, aggregate="constant"), "length"),
        (lambda: value_loss(ONES, ONES, MASK, clip=0.2), "old_values"),
        (lambda: kl_penalty(ONES, ONES, MASK, kind="k4"), "'k4'"),  # type: ignore[arg-type]
        (lambda: truncated_importance_weights(ONES, ONES, MASK, cap=0), "cap is 0"),
        (lambda: entropy(ONES, MASK), r"logits .*\(2, 3\)"),
    ],
)
def test_what_cannot_be_right_is_an_error(call, value: str):
    """The message names the argument and what was given."""
    with pytest.raises(ValueError, match=value):
        call()
